"""What is known of the drives of an arm, for feed-forward: gears and friction by joint."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from arm_emulator.base.number import Range
from arm_emulator.base.parameters import perhaps
from arm_emulator.base.refusal import Refusal

FloatArray = npt.NDArray[np.float64]

SECTION = "joints"  # of the motion controller's parameter file


def _number(unit: str, default: float, *, above: float | None = None) -> Any:
    at_least = 0.0 if above is None else None
    return field(default=default, metadata={"range": Range(unit, at_least=at_least, above=above)})


@dataclass(frozen=True)
class DriveNumbers:
    """The drive of a joint, all quantities seen at its link (a sliding joint: N, m, kg)."""

    stiffness: float = _number("N m/rad", math.inf, above=0.0)
    """Of the gear for small torques [N m/rad]; left out: rigid."""
    cubic_stiffness: float = _number("N m/rad3", 0.0)
    """With the cube of the wind-up [N m/rad3]."""
    damping: float = _number("N m s/rad", 0.0)
    """Of the gear [N m s/rad]."""
    viscous: float = _number("N m s/rad", 0.0)
    """Friction of the link per speed [N m s/rad]."""
    coulomb: float = _number("N m", 0.0)
    """Friction of the link at any speed [N m]."""
    rotor_viscous: float = _number("N m s/rad", 0.0)
    """Friction of the rotor per speed, divided by ratio**2 [N m s/rad]."""
    rotor_coulomb: float = _number("N m", 0.0)
    """Friction of the rotor at any speed, divided by |ratio| [N m]."""

    @classmethod
    def from_mapping(cls, table: object, where: str, path: str) -> DriveNumbers:
        """Validate the numbers of one joint.

        Raises:
            Refusal: an unknown key or an impossible value.
        """
        if not isinstance(table, Mapping):
            raise Refusal(where, path, "be a mapping", table)
        ranges = {one.name: one.metadata["range"] for one in fields(cls)}
        values = {}
        for key, value in table.items():
            if key not in ranges:
                got = f"an unknown one{perhaps(str(key), ranges)}"
                raise Refusal(where, f"{path}.{key}", "be a known key", got, ", ".join(ranges))
            if not ranges[key].holds(value):
                raise Refusal(where, f"{path}.{key}", ranges[key].rule, repr(value))
            values[key] = float(value)
        return cls(**values)


Drives = Mapping[str, DriveNumbers]


def drives_of(given: object, where: str) -> dict[str, DriveNumbers]:
    """Return the numbers of joints by their names.

    Args:
        given: nested mappings as in parameter files, or ROS's dotted names.
        where: name of their source, for refusals.

    Raises:
        Refusal: an unknown key or an impossible value.
    """
    if not isinstance(given, Mapping):
        raise Refusal(where, SECTION, "be a mapping", given)
    tables: dict[str, dict[str, Any]] = {}
    for name, value in given.items():
        if isinstance(value, Mapping):
            tables.setdefault(name, {}).update(value)
        else:  # a joint's name may have dots, a key has none
            joint, _, key = str(name).rpartition(".")
            if not joint:
                raise Refusal(where, f"{SECTION}.{name}", "be a mapping", value)
            tables.setdefault(joint, {})[key] = value
    return {
        name: DriveNumbers.from_mapping(table, where, f"{SECTION}.{name}")
        for name, table in tables.items()
    }


def column(drives: Sequence[DriveNumbers], key: str) -> FloatArray:
    """Return a number of all drives (N,)."""
    return np.array([getattr(drive, key) for drive in drives], dtype=np.float64)
