"""Numbers of an arm's drives for feed-forward: gears and friction by joint."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.number import number
from arm_emulator.base.validation.parameters import read_numbers, split_tables

SECTION = "joints"  # of the motion controller's parameter file


@dataclass(frozen=True)
class DriveParameters:
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


Drives = Mapping[str, DriveParameters]


def read_drives(section: object, where: str) -> dict[str, DriveParameters]:
    """Return the numbers of joints by their names."""
    return {
        name: DriveParameters(**read_numbers(table, DriveParameters, where, f"{SECTION}.{name}"))
        for name, table in split_tables(section, where, SECTION).items()
    }


def read_column(drives: Sequence[DriveParameters], key: str) -> Array:
    """Return a number of all drives (N,)."""
    return np.array([getattr(drive, key) for drive in drives], dtype=np.float64)
