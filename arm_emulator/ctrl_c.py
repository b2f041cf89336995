"""Ctrl-C, told once, ends a process once."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator

import rclpy
from rclpy.executors import ExternalShutdownException


class CtrlC:
    """Lets Ctrl-C break off what comes before `leave_to_rclpy`, and nothing after it.

    rclpy shuts its context down on a signal and passes it on to Python, which raises
    KeyboardInterrupt wherever it is by then: on a busy machine in the midst of the ending, too.
    Create it before ``rclpy.init``, in the main thread.
    """

    def __init__(self) -> None:
        self._breaks_off = True
        signal.signal(signal.SIGINT, self._on_signal)

    def leave_to_rclpy(self) -> None:
        """From now on only the context is shut down."""
        self._breaks_off = False

    def _on_signal(self, number: int, frame: object) -> None:
        if self._breaks_off:
            raise KeyboardInterrupt


@contextlib.contextmanager
def until_shut_down() -> Iterator[None]:
    """Take what rclpy raises in the block when a signal shuts it down for the block's end."""
    try:
        yield
    except ExternalShutdownException:
        pass
    except RuntimeError:
        # rclpy's handles fail in many words when they are shut down under a running callback.
        if rclpy.ok():
            raise
