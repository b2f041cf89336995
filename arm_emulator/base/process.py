"""Processes of this machine, as the system lists them."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

_STATE, _USER_TICKS, _SYSTEM_TICKS = 0, 11, 12  # of the fields behind a process's name


def runs(process: int) -> bool:
    """Return whether a process runs; one that has ended may still have its number."""
    try:
        return _fields(process)[_STATE] not in "ZX"
    except OSError:
        return False


def processor_time(process: int) -> float:
    """Return the processor time that a process has spent [s].

    Raises:
        OSError: there is no such process.
    """
    fields = _fields(process)
    ticks = int(fields[_USER_TICKS]) + int(fields[_SYSTEM_TICKS])
    return ticks / os.sysconf("SC_CLK_TCK")


def below(process: int) -> Iterator[int]:
    """Yield the processes that a process has begun, and those that these have begun."""
    with contextlib.suppress(OSError):
        for task in Path(f"/proc/{process}/task").iterdir():
            for child in map(int, (task / "children").read_text().split()):
                yield child
                yield from below(child)


def _fields(process: int) -> list[str]:
    # The name in brackets may have blanks and brackets of its own.
    return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
