"""Ctrl-C and SIGTERM end a process once, without a traceback, however often they are sent.

Ctrl-C is the usual end of a node and of the commands that run until they are stopped
(`up`, `record`, `replay`): exit code 0. It breaks off every other command: 130, and 143 after
SIGTERM, as shells have it.
"""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Iterator
from types import FrameType
from typing import ClassVar

END_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def keep_back() -> None:
    """Let signals wait until `end_at_once`: a moment in which too little is imported for both."""
    signal.pthread_sigmask(signal.SIG_BLOCK, END_SIGNALS)


def end_at_once(code: int | None) -> None:
    """From now on, until a `CtrlC` is made, end this process at once on a signal.

    Call it before anything that takes long is imported. There is nothing to put in order yet, and
    an exception in the midst of an import is printed, taken for another one, or swallowed.

    Args:
        code: the exit code; None: 128 + the signal's number.
    """

    def end(number: int, frame: FrameType | None) -> None:
        os._exit(exit_code(number, code))

    for number in END_SIGNALS:
        # Also where it is ignored, as it is in a job that a script has started with `&`.
        signal.signal(number, end)
    # A launcher may have kept signals back until here, see `Bringup`.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, END_SIGNALS)


def exit_code(number: int, code: int | None) -> int:
    """Return `code`, or 128 + the signal's number in the place of None."""
    return 128 + number if code is None else code


class CtrlC:
    """Lets Ctrl-C and SIGTERM break off what comes before `leave_to_rclpy`, and nothing after it.

    rclpy shuts its context down on a signal and passes it on to Python, which raises
    KeyboardInterrupt wherever it is by then: on a busy machine in the midst of the ending, too.
    Create it before ``rclpy.init``, in the main thread.

    In a `with` block, whatever a signal makes of the block ends there: KeyboardInterrupt, or what
    a library turns it into.

    Args:
        code: the exit code where it comes in the midst of an import, see `end_at_once`.

    Attributes:
        signal: number of the one that came first, 0 before any.
    """

    signal: ClassVar[int] = 0

    def __init__(self, code: int | None = 0) -> None:
        self._code = code
        self._breaks_off = True
        for number in END_SIGNALS:
            signal.signal(number, self._on_signal)

    def leave_to_rclpy(self) -> None:
        """From now on only the context is shut down."""
        self._breaks_off = False

    def break_off_again(self) -> None:
        """From now on as before `leave_to_rclpy`."""
        self._breaks_off = True

    def __enter__(self) -> CtrlC:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> bool:
        return bool(CtrlC.signal) and not isinstance(error, SystemExit)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        CtrlC.signal = CtrlC.signal or number
        if not self._breaks_off:
            return
        if _importing(frame):
            os._exit(exit_code(number, self._code))
        raise KeyboardInterrupt


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


@contextlib.contextmanager
def until_shut_down() -> Iterator[None]:
    """Take what rclpy raises in the block when a signal shuts it down for the block's end."""
    import rclpy
    from rclpy.executors import ExternalShutdownException

    try:
        yield
    except ExternalShutdownException:
        pass
    except RuntimeError:
        # rclpy's handles raise various errors when they are shut down under a running callback.
        if rclpy.ok():
            raise
