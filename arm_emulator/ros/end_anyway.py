"""A process end that does not wait for the middleware for ever.

Fast DDS 2.14 can deadlock when it removes its participant while another one announces its
departure, as when Ctrl-C ends several nodes at once: two of its threads wait for each other.
Python's lock is held meanwhile, so no Python code can step in; a timer of the C library can.
"""

from __future__ import annotations

import ctypes
import sys
import time

SIGEV_THREAD = 2  # call a function in a thread of its own


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


def end_anyway(seconds: float, code: int) -> None:
    """End this process with the exit code `code` after this many seconds, unless it has ended.

    Nothing is flushed or cleaned up then: call it when all is written.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    libc = ctypes.CDLL(None)
    exit_now = ctypes.cast(libc._exit, ctypes.c_void_p).value  # noqa: SLF001
    event = _Event(value=code, notify=SIGEV_THREAD, function=exit_now)
    timer = ctypes.c_void_p()
    whole, rest = divmod(seconds, 1.0)
    times = _Times(first=int(whole), first_ns=int(rest * 1e9))
    if libc.timer_create(time.CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)) == 0:
        libc.timer_settime(timer, 0, ctypes.byref(times), None)
