"""The servo's hot path in C: what is compiled, without ROS."""

from pathlib import Path

from arm_emulator.ros.c import FOLDER as ROS_FOLDER
from arm_emulator.servo.c import FOLDER as SERVO_FOLDER
from arm_emulator.toolchain.c_header import Header
from arm_emulator.toolchain.flags import C_FLAGS
from arm_emulator.toolchain.unit import Unit

FOLDER = Path(__file__).resolve().parent
ANSWERED_STATES = Header(FOLDER / "answered_states.h", (SERVO_FOLDER, ROS_FOLDER))


def make_answered_states_unit() -> Unit:
    """Return answered_states.h as what is compiled."""
    source = '#include "servo.c"\n#include "message_reader.c"\n#include "answered_states.c"\n'
    folders, headers = (FOLDER, ROS_FOLDER, SERVO_FOLDER), (ANSWERED_STATES,)
    about, part = "the servo's messages", "answered_states.c"
    return Unit("answered_states", source, C_FLAGS, folders, headers, "servo", about, part)
