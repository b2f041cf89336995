"""Removal of shared memory that killed processes have left behind.

Fast DDS keeps half a MiB in /dev/shm for each participant, beside a file that its owner locks as
long as it lives. A process that ends removes both; a killed one cannot, and no other process does.
Segments without an owner are removed here, as by `fastdds shm clean`. Ports stay: the next process
reuses them, and others may write to them. But a port whose maker was killed while it made it is
removed: every process that opens it waits for the maker, and reacts to no signal. A port whose
reader was killed is marked as broken: the next reader makes a new one, and a process that has the
old one open would write to it until its end. Fast DDS marks it only if the reader was killed while
it waited for a message or read one. It does not mark it in the microseconds between.

Versions: Fast DDS 2.14. Tests: test/toolchain/test_workarounds.py,
`test_fast_dds_is_that_of_the_workarounds`, and test/nodes/test_fastdds_shared_memory.py.
"""

import contextlib
import fcntl
import mmap
import os
import re
import struct
import time
from collections.abc import Iterator
from pathlib import Path

SHARED = Path("/dev/shm")
YOUNG = 2.0  # s: an owner first makes the file, then locks it
SLOWEST = 10.0  # s that the making of a port may take, which is microseconds of processor time
PORT_MAGIC = (2).to_bytes(4, "little")  # begins a port, by Boost's managed shared memory
_LOCK = re.compile(r"(?P<segment>fastrtps_[0-9a-f]{16})_el")
_PORT = re.compile(r"fastrtps_port[0-9]+")
_READER = re.compile(r"(?P<port>fastrtps_port(?P<number>[0-9]{1,5}))_el")  # locks an exclusive port
# Fast DDS's PortNode: number, listeners, patience [ms] of checks, a third of it, cells, waiting.
_NODE = struct.Struct("<6I")
_SOUND = 1  # in the byte behind: `is_port_ok`


def clear_left_over(shared: Path = SHARED) -> int:
    """Remove what ended processes of this user have left; return their number.

    Ports whose readers are gone are marked.
    """
    for lock, port, number in _find_locked_ports(shared):
        with contextlib.suppress(OSError, ValueError), _hold_lock(lock) as old:
            if old:
                _mark_as_broken(port, number)
    removed = 0
    for files in find_left_over(shared):
        with contextlib.suppress(OSError):
            for file in files:
                file.unlink(missing_ok=file is not files[-1])
            removed += 1
    return removed


def find_left_over(shared: Path = SHARED) -> Iterator[list[Path]]:
    """Yield files of each owner that is gone and was this user's: its segment and lock, or a port.

    The lock is held meanwhile.
    """
    with contextlib.suppress(OSError):  # no shared memory of this kind here
        for name in os.listdir(shared):
            file = shared / name
            if lock := _LOCK.fullmatch(name):
                with contextlib.suppress(OSError), _hold_lock(file) as old:
                    if old:
                        yield [shared / lock["segment"], file]
            elif _PORT.fullmatch(name) and _is_incomplete(file):
                yield [file]


def _find_locked_ports(shared: Path) -> Iterator[tuple[Path, Path, int]]:
    """Yield lock, file and number of each port with a lock; whether it is held is not known."""
    with contextlib.suppress(OSError):
        for name in os.listdir(shared):
            if lock := _READER.fullmatch(name):
                yield shared / name, shared / lock["port"], int(lock["number"])


def _mark_as_broken(port: Path, number: int) -> None:
    with _open_file(port, os.O_RDWR) as (opened, _), mmap.mmap(opened, 0) as memory:
        at = -1
        while (at := memory.find(struct.pack("<I", number), at + 1, -_NODE.size)) >= 0:
            _, _, patience, third, *_ = _NODE.unpack_from(memory, at)
            if patience > 0 and third == patience // 3:
                memory[at + _NODE.size] &= ~_SOUND


def _is_incomplete(port: Path) -> bool:
    with contextlib.suppress(OSError), _open_file(port) as (opened, status):
        mine = status.st_uid == os.geteuid()
        if mine and time.time() - status.st_mtime > SLOWEST:
            return os.read(opened, len(PORT_MAGIC)) != PORT_MAGIC
    return False


@contextlib.contextmanager
def _open_file(file: Path, how: int = os.O_RDONLY) -> Iterator[tuple[int, os.stat_result]]:
    opened = os.open(file, how | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        yield opened, os.fstat(opened)
    finally:
        os.close(opened)


@contextlib.contextmanager
def _hold_lock(lock: Path) -> Iterator[bool]:
    """Hold a lock for a block; False: it is not ours, or too new. OSError: its owner lives."""
    with _open_file(lock) as (opened, status):
        if status.st_uid != os.geteuid() or time.time() - status.st_mtime < YOUNG:
            yield False
            return
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield True
