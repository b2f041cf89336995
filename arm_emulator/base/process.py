"""Processes of this machine, as the system lists them."""

import contextlib
import ctypes
import signal
from collections.abc import Iterator
from pathlib import Path

_PR_SET_PDEATHSIG = 1  # of Linux


def list_end_signals() -> list[signal.Signals]:
    """Return the signals that end a process: of Ctrl-C, of `kill`, of a terminal that is closed.

    The last one is not among them where it is ignored, as in a job of `nohup`.
    """
    ignored = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    return [signal.SIGINT, signal.SIGTERM, *([] if ignored else [signal.SIGHUP])]


def request_signal_at_parent_end(number: int) -> None:
    """Let the system send this process a signal when the thread that began it ends."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number)


def is_running(process: int) -> bool:
    """Return whether a process runs; one that has ended may still have its number."""
    try:
        # The name in brackets may have blanks and brackets of its own.
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def list_descendants(process: int) -> Iterator[int]:
    """Yield the processes that a process has begun, and those that these have begun."""
    with contextlib.suppress(OSError):
        for task in Path(f"/proc/{process}/task").iterdir():
            for child in map(int, (task / "children").read_text().split()):
                yield child
                yield from list_descendants(child)
