"""The process that writes the rows of a run into a file, see `arm_emulator.runs.recorder`.

It ends when its input does: the run is over, however it ended.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import select
import signal
import sys
from collections.abc import Callable
from typing import Any

from arm_emulator.base.column import Rows
from arm_emulator.base.record_file import RecordFile, open_record
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.record_ring import SharedRing

IDLE = 0.01  # s, wall: how often an empty ring is looked at


def main() -> None:
    """Take rows until the run is over; print what went wrong."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    os.nice(5)
    task = pickle.load(sys.stdin.buffer)
    files: list[RecordFile] = []
    try:
        ring = SharedRing(task["memory"], task["kind"])
        show, end = _view(task)
        if task["record"] is not None:
            files.append(open_record("record", task["record"], task["columns"]))
    except Refusal as no:
        report(no)
        return
    report(None)
    trouble = ""
    try:
        _take_all(ring, files, show)
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        trouble = f"the disk takes no more: {reason}"
    report("; ".join(filter(None, (trouble, end()))))


def report(what: Refusal | str | None) -> None:
    """Hand the run a refusal or None, and at the end what went wrong."""
    with contextlib.suppress(BrokenPipeError):  # the run was killed
        pickle.dump(what, sys.stdout.buffer)
        sys.stdout.flush()


def _take_all(ring: SharedRing, files: list[RecordFile], show: Callable[[Rows], None]) -> None:
    """Take rows until input ends.

    Raises:
        OSError: what the disk has refused; the files are whole, or gone.
    """
    over = False
    try:
        while True:
            rows = ring.take()
            if len(rows):
                show(rows)
                for file in files:
                    file.write(rows)
            elif over:
                break
            else:  # rows that were written before the end are there when it is seen
                over = bool(select.select([sys.stdin], [], [], IDLE)[0])
        for file in files:
            file.close()
    except OSError:
        for file in files:
            file.give_up()
        raise


def _view(task: dict[str, Any]) -> tuple[Callable[[Rows], None], Callable[[], str]]:
    """Return what shows rows, and what ends the show."""
    if task["rerun"] is None:
        return lambda rows: None, lambda: ""
    from arm_emulator.view.rerun_rows import RerunRows

    rows = RerunRows(task["rerun"], task["columns"], task["angle_per_count"], task["view"])
    return rows.show, rows.close


if __name__ == "__main__":
    main()
