"""Inputs of motors: each declared once, by the motor or by a decorator around it.

Commands of plants and fleets, messages, FMU variables and registers follow from these lists.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Input:
    """A quantity that a motor takes, held over a servo period.

    The first of a motor is its command. Further ones are 0 unless they are given; they are given by
    name, and what the motor got of each is an output.

    Attributes:
        name: `command`, or that of a further input, everywhere.
        about: what it is, of each motor.
        unit: of its values.
        mode: of a command: enum arm_mode in arm.h.
        applied: of a further input: the output that has what the motor got.
    """

    name: str
    about: str
    unit: str
    mode: str = ""
    applied: str = ""


VOLTAGE = Input("command", "voltage across each winding", "V", mode="ARM_VOLTAGE")
TORQUE = Input("command", "torque of each motor", "N m", mode="ARM_TORQUE")
CURRENT = Input("command", "current of each motor", "A", mode="ARM_CURRENT")
