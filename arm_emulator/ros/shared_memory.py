"""Shared memory that killed processes have left behind.

Fast DDS keeps half a MiB in /dev/shm for each participant, beside a file on which its owner holds
a lock as long as it lives. A process that ends removes both; one that is killed cannot, and
nobody else does. What has no owner any more is removed here, as `fastdds shm clean` does. Its ports
stay: they are taken up again by the next process, and others may write to them.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import time
from pathlib import Path

SHARED = Path("/dev/shm")
YOUNG = 2.0  # s: a segment's owner makes the file first, and locks it then
_LOCK = re.compile(r"(?P<segment>fastrtps_[0-9a-f]{16})_el")


def clear_left_over(shared: Path = SHARED) -> int:
    """Remove the segments of this user whose owners are gone, and return how many."""
    removed = 0
    with contextlib.suppress(OSError):  # no shared memory of this kind here
        for name in os.listdir(shared):
            lock = _LOCK.fullmatch(name)
            if lock:
                with contextlib.suppress(OSError):  # its owner lives, or has just ended
                    removed += _clear(shared / name, shared / lock["segment"])
    return removed


def _clear(lock: Path, segment: Path) -> bool:
    opened = os.open(lock, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        found = os.fstat(opened)
        if found.st_uid != os.geteuid() or time.time() - found.st_mtime < YOUNG:
            return False
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        segment.unlink(missing_ok=True)
        lock.unlink()
        return True
    finally:
        os.close(opened)
