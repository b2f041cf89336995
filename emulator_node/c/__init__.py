"""The emulator's hot paths in C: what is compiled, without ROS."""

from pathlib import Path

from arm_emulator.ros.c import FOLDER as ROS_FOLDER
from arm_emulator.tick.c import FOLDERS as TICK_FOLDERS
from arm_emulator.toolchain.c_header import Header
from arm_emulator.toolchain.flags import C_FLAGS
from arm_emulator.toolchain.unit import Unit

FOLDER = Path(__file__).resolve().parent
FOLDERS = (FOLDER, ROS_FOLDER, *TICK_FOLDERS)
MOTOR_COMMANDS = Header(FOLDER / "motor_commands.h", FOLDERS)
ANSWERED_TICKS = Header(FOLDER / "answered_ticks.h", FOLDERS)
REAL_TIME_TICKS = Header(FOLDER / "real_time_ticks.h", FOLDERS)


def make_answered_ticks_unit() -> Unit:
    """Return answered_ticks.h as what is compiled."""
    return _make_unit("answered_ticks", ANSWERED_TICKS, "lock-step")


def make_real_time_ticks_unit() -> Unit:
    """Return real_time_ticks.h as what is compiled."""
    return _make_unit("real_time_ticks", REAL_TIME_TICKS, "messages in real time")


def _make_unit(name: str, header: Header, about: str) -> Unit:
    parts = ("messages", "message_reader", "motor_commands", "tick", "answers", name)
    source = "".join(f'#include "{part}.c"\n' for part in parts)
    return Unit(name, source, C_FLAGS, FOLDERS, (header,), "emulator", about, f"{name}.c")
