"""The end of a `RowProcess` in its own process: its task, its answers, and when it has to end."""

import contextlib
import os
import pickle
import select
import signal
import sys
from types import FrameType
from typing import Any, NoReturn

from arm_emulator.base.process import request_signal_at_parent_end

_ORPHANED = signal.SIGUSR1  # which the system sends when the run has ended


class RowEnd:
    """Common part of the modules that take rows; each process has one.

    The process ends when its input does: the run is over, however it ended. The system kills it if
    it has not ended some seconds after SIGTERM, or after the run has died: it may hang in a file
    that takes nothing. The first of these reasons counts, others give it no further time. Ctrl-C is
    for the run, which then ends this process.

    Attributes:
        task: what the run has handed over.
        stopped: whether SIGTERM came.

    Args:
        niceness: that is added to that of the run.
        grace: time to end in [s].
    """

    def __init__(self, niceness: int, grace: float) -> None:
        descriptor, run = map(int, sys.argv[1:3])
        self._responses = os.fdopen(descriptor, "wb", buffering=0)
        self._run, self._grace = run, grace
        self.stopped = False
        for number in (signal.SIGINT, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, self._stop_rows)
        signal.signal(_ORPHANED, self._handle_orphaned)
        request_signal_at_parent_end(_ORPHANED)
        self._handle_orphaned()  # it may have died before that
        os.nice(niceness)
        self.task: dict[str, Any] = pickle.load(sys.stdin.buffer)

    def is_over(self, timeout: float) -> bool:
        """Return whether the process has to end, after a wait of at most `timeout` [s]."""
        return self.stopped or bool(select.select([sys.stdin], [], [], timeout)[0])

    def send_answer(self, value: Any) -> None:
        """Hand the run an answer, see `RowProcess`."""
        with contextlib.suppress(BrokenPipeError):  # the run was killed
            self._responses.write(pickle.dumps(value))

    def send_last_answer(self, value: Any) -> NoReturn:
        """Hand the run the last answer, and end.

        Python's own end has nothing to save here. On a busy machine it takes seconds.
        """
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        self.send_answer(value)
        os._exit(0)

    def end_in_time(self) -> None:
        """Let the system kill this process unless it ends within the time that it has for that."""
        if not signal.getitimer(signal.ITIMER_REAL)[0]:
            signal.setitimer(signal.ITIMER_REAL, self._grace)

    def _stop_rows(self, number: int, frame: FrameType | None) -> None:
        self.stopped = True
        self.end_in_time()

    def _handle_orphaned(self, number: int = 0, frame: FrameType | None = None) -> None:
        # The system sends the signal when the thread of the run that began this process ends, too.
        if os.getppid() != self._run:
            self.end_in_time()
