"""A process end that the middleware can neither hold up nor spoil.

Fast DDS 2.14 can deadlock when it removes its participant while another one announces its
departure, as when Ctrl-C ends several nodes at once: two of its threads wait for each other.
Python's lock is held meanwhile, so no Python code can step in; a timer of the C library can.

Fast DDS can also crash there. A process that is killed while it writes into a port of this one's
shared memory leaves the port locked. The removal waits for that lock, and so does the thread that
receives. After a second this thread unmaps the port, which the removal still reads.

Versions: Fast DDS 2.14. Test: test/toolchain/test_workarounds.py,
`test_fast_dds_is_that_of_the_workarounds`.
"""

import contextlib
import ctypes
import signal
import sys
import time
from collections.abc import Iterator

SIGEV_THREAD = 2  # call a function in a thread of its own
CRASHES = (signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT)


class _Event(ctypes.Structure):
    """``struct sigevent`` of POSIX, as Linux has it."""

    _fields_ = (
        ("value", ctypes.c_void_p),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("attributes", ctypes.c_void_p),
        ("_room", ctypes.c_char * 32),
    )


class _Times(ctypes.Structure):
    """``struct itimerspec``: interval and first time, each in s and ns."""

    _fields_ = tuple(
        (name, ctypes.c_long) for name in ("interval", "interval_ns", "first", "first_ns")
    )


@contextlib.contextmanager
def start_exit_watchdog(seconds: float, code: int) -> Iterator[None]:
    """End this process with the exit code `code` after this many seconds, unless it has ended.

    Nothing is flushed or cleaned up then: enter it when all is written. A thread that crashes in
    the block stands still instead, until the process ends so.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    libc = ctypes.CDLL(None)
    exit_now = ctypes.cast(libc._exit, ctypes.c_void_p).value  # noqa: SLF001
    event = _Event(value=code, notify=SIGEV_THREAD, function=exit_now)
    timer = ctypes.c_void_p()
    full_seconds, rest = divmod(seconds, 1.0)
    times = _Times(first=int(full_seconds), first_ns=int(rest * 1e9))
    if libc.timer_create(time.CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)) != 0:
        yield
        return
    libc.timer_settime(timer, 0, ctypes.byref(times), None)
    handle = libc.signal
    handle.argtypes, handle.restype = (ctypes.c_int, ctypes.c_void_p), ctypes.c_void_p
    # It sleeps for as many seconds as the signal's number states, and again at the next attempt of
    # what has crashed.
    stand = ctypes.cast(libc.sleep, ctypes.c_void_p)
    before = {number: handle(number, stand) for number in CRASHES}
    try:
        yield
    finally:
        for number, handler in before.items():
            handle(number, handler)
