"""The servo law of servo.c, compiled; its declarations are read from servo.h."""

from typing import Any

import numpy.typing as npt

from arm_emulator.servo.c import FOLDER
from arm_emulator.toolchain.c_header import Header
from arm_emulator.toolchain.compile_unit import compile_once
from arm_emulator.toolchain.flags import C_FLAGS
from arm_emulator.toolchain.unit import Unit

SERVO = Header(FOLDER / "servo.h")

FOLLOWS, HOLDS, CUT = map(SERVO.get_constant, ("SERVO_FOLLOWS", "SERVO_HOLDS", "SERVO_CUT"))
HEARS, NO_TARGET = map(SERVO.get_constant, ("SERVO_HEARS", "SERVO_NO_TARGET"))
LATE_TARGET, LATE_STATE = map(SERVO.get_constant, ("SERVO_LATE_TARGET", "SERVO_LATE_STATE"))
POSITION, SPEED, CURRENT = map(
    SERVO.get_constant, ("SERVO_POSITION", "SERVO_SPEED", "SERVO_CURRENT")
)

Rows = npt.NDArray[Any]  # of structs, an entry per joint


def make_servo_unit() -> Unit:
    """Return the law as what is compiled."""
    source = '#include "servo.c"\n'
    return Unit("servo", source, C_FLAGS, (FOLDER,), (SERVO,), "servo", "the servo", "servo.c")


servo_law = compile_once(make_servo_unit)
