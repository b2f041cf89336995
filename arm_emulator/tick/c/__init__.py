"""The tick layer: a period of two calls, loops, clocks; its headers and what is compiled."""

from pathlib import Path

from arm_emulator.core import BOUNDARY
from arm_emulator.toolchain.c_header import Header
from arm_emulator.toolchain.compile_unit import compile_once
from arm_emulator.toolchain.flags import C_FLAGS
from arm_emulator.toolchain.unit import Unit

FOLDER = Path(__file__).resolve().parent
FOLDERS = (FOLDER, BOUNDARY)
COMMAND_BUFFER = Header(FOLDER / "answers.h", FOLDERS)
TICK = Header(FOLDER / "tick.h", FOLDERS)
FIRMWARE_CONTROLLER = Header(FOLDER / "firmware_controller.h", FOLDERS)
REAL_TIME = Header(FOLDER / "real_time.h", FOLDERS)


def tick_unit() -> Unit:
    """Return periods, their loop and control code as what is compiled."""
    parts = ("tick.c", "answers.c", "firmware_controller.c")
    source = "".join(f'#include "{part}"\n' for part in parts)
    headers, about = (TICK, COMMAND_BUFFER, FIRMWARE_CONTROLLER), "servo periods"
    return Unit("tick", source, C_FLAGS, FOLDERS, headers, "tick", about, "tick.c")


tick_calls = compile_once(tick_unit)
