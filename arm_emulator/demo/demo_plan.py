"""What the demo does with a scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.base.config_files import find_beside
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.yaml_file import read_yaml

NANOSECONDS = 1_000_000_000
LARGEST_DISPLACEMENT = 100.0  # m
LONGEST_SETTLING = 1000.0  # s
MOST_INSTRUCTIONS = 1_000_000


@dataclass(frozen=True)
class DemoPlan:
    """A displacement of the tool, when it begins, and for how long it is watched."""

    displacement: NDArray[np.float64]  # m (3,), of the tool in the world
    settle_ns: int  # logical time before the target holds, a multiple of the motion period
    instructions: int

    @classmethod
    def load(cls, scene: Path, period_ns: int) -> DemoPlan:
        """Read the plan that belongs to a scene file, for a motion period.

        Raises:
            Refusal: no plan, or a value that is not taken.
        """
        file = find_beside(scene, "demo")
        data = read_yaml(file)
        keys = ("displacement", "settle", "instructions")
        for key in data:
            if key not in keys:
                raise Refusal(file.name, f"key {key}", "be known", repr(key), ", ".join(keys))
        displacement = data.get("displacement")
        rule = f"be 3 numbers of at most {LARGEST_DISPLACEMENT:g} [m]"
        if not isinstance(displacement, list) or len(displacement) != 3:
            raise Refusal(file.name, "displacement", rule, repr(displacement))
        for entry in displacement:
            _check(entry, -LARGEST_DISPLACEMENT, LARGEST_DISPLACEMENT, file, "displacement", "m")
        settle, instructions = data.get("settle"), data.get("instructions")
        _check(settle, 0.0, LONGEST_SETTLING, file, "settle", "s")
        _check(instructions, 1, MOST_INSTRUCTIONS, file, "instructions", "whole")
        if not float(instructions).is_integer():  # type: ignore[arg-type]
            raise Refusal(file.name, "instructions", "be a whole number", instructions)
        periods = round(float(settle) * NANOSECONDS / period_ns)  # type: ignore[arg-type]
        return cls(np.array(displacement, dtype=np.float64), periods * period_ns, int(instructions))  # type: ignore[arg-type]


def _check(value: Any, low: float, high: float, file: Path, key: str, unit: str) -> None:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not math.isfinite(value) or not low <= value <= high:
        got = "nothing" if value is None else repr(value)
        raise Refusal(file.name, key, f"be a number from {low:g} to {high:g} [{unit}]", got)
