"""The emulator's hot path in C: what is compiled, without ROS."""

from pathlib import Path

from arm_emulator.build.c_header import Header
from arm_emulator.build.flags import C_FLAGS
from arm_emulator.build.unit import Unit
from arm_emulator.core import BOUNDARY
from arm_emulator.ros.c import FOLDER as ROS_FOLDER

FOLDER = Path(__file__).resolve().parent
ANSWERED_TICKS = Header(FOLDER / "answered_ticks.h", (BOUNDARY, ROS_FOLDER))


def answered_ticks_unit() -> Unit:
    """Return answered_ticks.h as what is compiled."""
    source = '#include "messages.c"\n#include "answered_ticks.c"\n'
    folders, headers = (FOLDER, ROS_FOLDER, BOUNDARY), (ANSWERED_TICKS,)
    about, part = "lock-step", "answered_ticks.c"
    return Unit("answered_ticks", source, C_FLAGS, folders, headers, "emulator", about, part)
