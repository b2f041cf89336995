"""Ctrl-C, SIGTERM and SIGHUP end a process once, without a traceback, however often they come.

Ctrl-C is the usual end of a node and of the commands that run until they are stopped
(`up`, `record`, `replay`): exit code 0. It breaks off every other command: 130, 143 after
SIGTERM, and 129 after SIGHUP, as in shells.
"""

import contextlib
import os
import signal
from collections.abc import Iterator
from types import FrameType
from typing import ClassVar, Self

from arm_emulator.base.process import list_end_signals


def block_signals() -> None:
    """Hold signals until `end_at_once`, before a process can handle them without a traceback."""
    signal.pthread_sigmask(signal.SIG_BLOCK, list_end_signals())


def end_at_once(code: int | None) -> None:
    """End this process at once on a signal, until a `CtrlC` is made.

    Call it before modules that take long are imported. There is nothing to clean up yet, and an
    exception in the midst of an import is printed, mistaken for another one, or swallowed.

    Args:
        code: the exit code; None: 128 + the signal's number.
    """

    def end_process(number: int, frame: FrameType | None) -> None:
        os._exit(get_exit_code(number, code))

    for number in list_end_signals():
        # Also where Ctrl-C is ignored, as it is in a job that a script has started with `&`.
        signal.signal(number, end_process)
    # A launcher may have kept signals back until here, see `Bringup`.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, list_end_signals())


def ignore_signals() -> None:
    """Ignore signals: all is done, and Python would let them kill it while it ends."""
    for number in list_end_signals():
        signal.signal(number, signal.SIG_IGN)


def get_exit_code(number: int, code: int | None) -> int:
    """Return `code`, or 128 + the signal's number in the place of None."""
    return 128 + number if code is None else code


class CtrlC:
    """Lets signals that end a process interrupt code from a `with` block to `leave_to_rclpy`.

    rclpy shuts its context down on a signal and passes it on to Python, which raises
    KeyboardInterrupt wherever it is by then: on a busy machine even during the shutdown.
    Create it before ``rclpy.init``, in the main thread.

    The block ends on a signal, with KeyboardInterrupt or the exception that a library makes of it.
    A signal before the block ends the process at once.

    Args:
        code: the exit code of a signal before the block, or in the midst of an import, see
            `end_at_once`.

    Attributes:
        signal: number of the first signal, 0 before any.
    """

    signal: ClassVar[int] = 0
    _interrupts: ClassVar[bool] = False
    _delays: ClassVar[bool] = False  # in a block that a signal interrupts at its end
    _delayed: ClassVar[bool] = False  # a signal in it

    def __init__(self, code: int | None = 0) -> None:
        self._code = code
        for number in list_end_signals():
            signal.signal(number, self._handle_signal)

    @classmethod
    def leave_to_rclpy(cls) -> None:
        """From now on a signal only shuts down the context."""
        cls._interrupts = False

    @classmethod
    def break_off_again(cls) -> None:
        """Return to the behaviour before `leave_to_rclpy`."""
        cls._interrupts = True

    @classmethod
    @contextlib.contextmanager
    def delay_interrupt(cls) -> Iterator[None]:
        """Let a signal in the block interrupt at its end: for short work of libraries.

        An exception in the midst of a constructor leaves objects behind that complain when they are
        deleted.
        """
        cls._delays = True
        try:
            yield
        finally:
            cls._delays, interrupted, cls._delayed = False, cls._delayed, False
            if interrupted:
                raise KeyboardInterrupt

    def __enter__(self) -> Self:
        if CtrlC.signal:
            os._exit(get_exit_code(CtrlC.signal, self._code))
        CtrlC._interrupts = True  # Python runs no handler between here and the block
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> bool:
        ignore_signals()  # which would break off what ends now
        return bool(CtrlC.signal) and not isinstance(error, SystemExit)

    def _handle_signal(self, number: int, frame: FrameType | None) -> None:
        CtrlC.signal = CtrlC.signal or number
        if number == signal.SIGHUP:  # which rclpy does not know
            signal.raise_signal(signal.SIGTERM)
            return
        if not CtrlC._interrupts:
            return
        if CtrlC._delays:
            CtrlC._delayed = True
            return
        if _is_importing(frame):
            os._exit(get_exit_code(CtrlC.signal, self._code))
        raise KeyboardInterrupt


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


@contextlib.contextmanager
def suppress_shutdown_errors() -> Iterator[None]:
    """Treat what rclpy raises in the block after a signal's shutdown as the end of the block."""
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
