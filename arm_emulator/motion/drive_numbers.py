"""Numbers of an arm's drives for feed-forward: gears and friction by joint."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from arm_emulator.base.given import FloatArray
from arm_emulator.base.number import number, numbers_of
from arm_emulator.base.parameters import perhaps
from arm_emulator.base.refusal import Refusal

SECTION = "joints"  # of the motion controller's parameter file


@dataclass(frozen=True)
class DriveNumbers:
    """The drive of a joint, all quantities seen at its link (a sliding joint: N, m, kg)."""

    stiffness: float = number(
        "N m/rad",
        above=0.0,
        default=math.inf,
        text="stiffness of the gear for small torques; none: rigid",
    )
    cubic_stiffness: float = number(
        "N m/rad3", at_least=0.0, default=0.0, text="stiffness with the cube of the wind-up"
    )
    damping: float = number("N m s/rad", at_least=0.0, default=0.0, text="damping of the gear")
    viscous: float = number(
        "N m s/rad", at_least=0.0, default=0.0, text="friction of the link per speed"
    )
    coulomb: float = number(
        "N m", at_least=0.0, default=0.0, text="friction of the link at any speed"
    )
    rotor_viscous: float = number(
        "N m s/rad",
        at_least=0.0,
        default=0.0,
        text="friction of the rotor per speed, divided by ratio**2",
    )
    rotor_coulomb: float = number(
        "N m",
        at_least=0.0,
        default=0.0,
        text="friction of the rotor at any speed, divided by |ratio|",
    )

    @classmethod
    def from_mapping(cls, table: object, where: str, path: str) -> DriveNumbers:
        """Validate the numbers of one joint.

        Raises:
            Refusal: an unknown key or an impossible value.
        """
        if not isinstance(table, Mapping):
            raise Refusal(where, path, "be a mapping", table)
        known, values = numbers_of(cls), {}
        for key, value in table.items():
            if key not in known:
                got = f"an unknown one{perhaps(str(key), known)}"
                raise Refusal(where, f"{path}.{key}", "be a known key", got, ", ".join(known))
            values[key] = known[key].named(f"{path}.{key}").take(where, value)
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
