"""Outputs of parts: each quantity is declared once, by its part.

Measurement, messages, FMU variables, registers, the comparison of recorded runs and Rerun's signals
follow from these lists.
"""

from dataclasses import dataclass
from typing import Literal

AXES = 3  # of inertial measurement units
COMMAND = "command"  # the unit of what a joint's motor is commanded: V, N m or A
READINGS = "readings"  # the symbol of what has no field of its own in arm.h
FURTHER = "further"  # and of what a motor got of a further input

Kind = Literal["number", "count", "flag", "bits"]


@dataclass(frozen=True)
class Output:
    """A quantity that is measured at each tick, with a value per joint or per unit.

    Attributes:
        name: in `Plant.measured` and everywhere else.
        about: what it is, of each joint or unit.
        symbol: where arm.h has it: a field of `arm_joint_measurement` (joint.NAME), of
            `arm_joint_sensors` (sensors.NAME) or of `arm_imu_measurement` (imu.NAME), an array of
            `arm_measurement`, `READINGS` or `FURTHER`.
        unit: of a joint that turns; none of counts, flags and bits.
        unit_of_slides: where that of a joint that slides is another one.
        kind: of its values.
        per_unit: whether it has three values per inertial measurement unit, and none per joint.
        cia: the object of a CiA 402 drive that has it, in its unit or a thousandth; 0: none.
    """

    name: str
    about: str
    symbol: str
    unit: str = ""
    unit_of_slides: str = ""
    kind: Kind = "number"
    per_unit: bool = False
    cia: int = 0

    def choose_unit(self, kind: str) -> str:
        """Return its unit at a joint.

        Args:
            kind: of the joint, revolute or prismatic.
        """
        return self.unit_of_slides or self.unit if kind == "prismatic" else self.unit


# Of every drive; windings with a limit bring it into messages.
FAULTS = Output(
    "faults", "of each drive: 1 diverged, 2 winding too hot, 3 both", "joint.faults", kind="bits"
)
