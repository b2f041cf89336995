"""Messages in C, beside rclpy: what is compiled, without ROS."""

from pathlib import Path

from arm_emulator.toolchain.c_header import Header
from arm_emulator.toolchain.flags import C_FLAGS
from arm_emulator.toolchain.unit import Unit

FOLDER = Path(__file__).resolve().parent
WORKAROUNDS = FOLDER.parents[1] / "workarounds"  # rcl_calls.h
MESSAGES = Header(FOLDER / "messages.h")
MESSAGE_READER = Header(FOLDER / "message_reader.h")
MIDDLEWARE = Header(FOLDER / "middleware.h")
ARRIVALS = Header(FOLDER / "arrivals.h")


def make_middleware_unit() -> Unit:
    """Return middleware.h and what is beside it, to be compiled. It is loaded where librcl is."""
    parts = ("middleware.c", "arrivals.c", "bytes.c", "messages.c", "message_reader.c")
    source = "".join(f'#include "{part}"\n' for part in parts)
    about, part = "messages in C", "middleware.c"
    headers = (MESSAGES, MESSAGE_READER, MIDDLEWARE, ARRIVALS)
    return Unit("middleware", source, C_FLAGS, (FOLDER, WORKAROUNDS), headers, "node", about, part)
