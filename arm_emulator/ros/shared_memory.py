"""Removal of shared memory that killed processes have left behind.

Fast DDS keeps half a MiB in /dev/shm for each participant, beside a file that its owner locks as
long as it lives. A process that ends removes both; a killed one cannot, and no other process does.
Segments without an owner are removed here, as by `fastdds shm clean`. Ports stay: the next process
reuses them, and others may write to them. But a port whose maker was killed while it made it is
removed: every process that opens it waits for the maker, for ever and deaf to signals.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import time
from collections.abc import Iterator
from pathlib import Path

SHARED = Path("/dev/shm")
YOUNG = 2.0  # s: an owner first makes the file, then locks it
SLOWEST = 10.0  # s that the making of a port may take, which is microseconds of processor time
MADE = (2).to_bytes(4, "little")  # begins a port, by Boost's managed shared memory
_LOCK = re.compile(r"(?P<segment>fastrtps_[0-9a-f]{16})_el")
_PORT = re.compile(r"fastrtps_port[0-9]+")


def clear_left_over(shared: Path = SHARED) -> int:
    """Remove what owners of this user have left who are gone; return of how many."""
    removed = 0
    for files in left_over(shared):
        with contextlib.suppress(OSError):
            for file in files:
                file.unlink(missing_ok=file is not files[-1])
            removed += 1
    return removed


def left_over(shared: Path = SHARED) -> Iterator[list[Path]]:
    """Yield files of each owner that is gone and was this user's: its segment and lock, or a port.

    The lock is held meanwhile.
    """
    with contextlib.suppress(OSError):  # no shared memory of this kind here
        for name in os.listdir(shared):
            file = shared / name
            if lock := _LOCK.fullmatch(name):
                with contextlib.suppress(OSError), _held(file) as old:
                    if old:
                        yield [shared / lock["segment"], file]
            elif _PORT.fullmatch(name) and _half_made(file):
                yield [file]


def _half_made(port: Path) -> bool:
    with contextlib.suppress(OSError), _opened(port) as (opened, found):
        mine = found.st_uid == os.geteuid()
        if mine and time.time() - found.st_mtime > SLOWEST:
            return os.read(opened, len(MADE)) != MADE
    return False


@contextlib.contextmanager
def _opened(file: Path) -> Iterator[tuple[int, os.stat_result]]:
    opened = os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        yield opened, os.fstat(opened)
    finally:
        os.close(opened)


@contextlib.contextmanager
def _held(lock: Path) -> Iterator[bool]:
    """Hold a lock for a block; False: it is not ours, or too new. OSError: its owner lives."""
    with _opened(lock) as (opened, found):
        if found.st_uid != os.geteuid() or time.time() - found.st_mtime < YOUNG:
            yield False
            return
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield True
