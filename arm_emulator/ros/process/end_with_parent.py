"""End of a node when the program that started it is gone, for any reason.

`ros2 launch` that is ended by SIGTERM leaves its nodes alone, and a launcher that is killed
cannot end its nodes. So it passes its process id to them, and they ask the system for a signal.
"""

import os
import signal
import sys

from arm_emulator.base.process import is_running, request_signal_at_parent_end

VARIABLE = "ARM_EMULATOR_PARENT"


def get_parent_environment() -> dict[str, str]:
    """Return the variable that a launcher adds to the environment of its nodes."""
    return {VARIABLE: str(os.getpid())}


def end_with_parent() -> None:
    """End this process as Ctrl-C does when the launcher named in its environment ends."""
    launcher = os.environ.pop(VARIABLE, "")
    if not launcher.isdecimal():
        return
    if os.getppid() == int(launcher):
        request_signal_at_parent_end(signal.SIGINT)
    if not is_running(int(launcher)):  # it ended before that
        sys.exit(0)
