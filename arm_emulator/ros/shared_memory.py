"""Removal of shared memory that killed processes have left behind.

Fast DDS keeps half a MiB in /dev/shm for each participant, beside a file that its owner locks as
long as it lives. A process that ends removes both; a killed one cannot, and no other process does.
Segments without an owner are removed here, as by `fastdds shm clean`. Ports stay: the next process
reuses them, and others may write to them.
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
_LOCK = re.compile(r"(?P<segment>fastrtps_[0-9a-f]{16})_el")


def clear_left_over(shared: Path = SHARED) -> int:
    """Remove the segments of this user whose owners are gone, and return how many."""
    removed = 0
    for lock, segment in left_over(shared):
        with contextlib.suppress(OSError):
            segment.unlink(missing_ok=True)
            lock.unlink()
            removed += 1
    return removed


def left_over(shared: Path = SHARED) -> Iterator[tuple[Path, Path]]:
    """Yield lock and segment of each owner that is gone and was this user's; holds the lock."""
    with contextlib.suppress(OSError):  # no shared memory of this kind here
        for name in os.listdir(shared):
            lock = _LOCK.fullmatch(name)
            if lock:
                with contextlib.suppress(OSError), _held(shared / name) as old:
                    if old:
                        yield shared / name, shared / lock["segment"]


@contextlib.contextmanager
def _held(lock: Path) -> Iterator[bool]:
    """Hold a lock for a block; False: it is not ours, or too new. OSError: its owner lives."""
    opened = os.open(lock, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        found = os.fstat(opened)
        if found.st_uid != os.geteuid() or time.time() - found.st_mtime < YOUNG:
            yield False
            return
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield True
    finally:
        os.close(opened)
