"""The demo's motions of a scene."""

from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from arm_emulator.base.io.config_files import find_beside
from arm_emulator.base.io.yaml_file import read_yaml
from arm_emulator.base.validation.number import Number
from arm_emulator.base.validation.section import Section

NANOSECONDS = 1_000_000_000

_DISPLACEMENT = Number.bound_size("displacement", "m", 100.0)
_SETTLE = Number("settle", "s", at_least=0.0, at_most=1000.0)
_DEMO_MOTION = Number.bound_size("shown", "m", 100.0)
_INSTRUCTIONS = Number("instructions", at_least=1, at_most=1_000_000, whole=True)


@dataclass(frozen=True)
class DemoPlan:
    """A displacement of the tool, its start, and the time of observation.

    Attributes:
        motion: a displacement of the tool after the observation, of the observation's duration. It
            makes a motion of the arm visible in the recording. None: no such motion.
    """

    displacement: NDArray[np.float64]  # m (3,), of the tool in the world
    settle_ns: int  # logical time before the target holds, a multiple of the motion period
    instructions: int
    motion: NDArray[np.float64] | None = None  # m (3,), of the tool in the world

    @classmethod
    def load_plan(cls, scene: Path, period_ns: int) -> Self:
        """Read the plan that belongs to a scene file, for a motion period.

        Raises:
            Refusal: the plan is missing, or a value is refused.
        """
        file = find_beside(scene, "demo")
        section = Section(read_yaml(file), file.name)
        displacement = section.read_vector(_DISPLACEMENT)
        settle, instructions = section.read_number(_SETTLE), section.read_integer(_INSTRUCTIONS)
        motion = section.read_vector(_DEMO_MOTION)
        section.refuse_unread_keys()
        if displacement is None:
            raise section.make_refusal("displacement", "be given", "nothing")
        periods = round(settle * NANOSECONDS / period_ns)
        return cls(
            np.array(displacement),
            periods * period_ns,
            instructions,
            None if motion is None else np.array(motion),
        )
