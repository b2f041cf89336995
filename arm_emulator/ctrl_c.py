"""Ctrl-C, told once, ends a process once."""

from __future__ import annotations

import signal


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
