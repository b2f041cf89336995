"""The process that writes the rows of a run into a file, see `arm_emulator.runs.recorder`.

It ends when its input does: the run is over, however it ended.
"""

import os
from collections.abc import Callable
from typing import Any

from arm_emulator.base.column import Rows
from arm_emulator.base.io.record_file import RecordFile, open_record
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.session.record_ring import SharedRing
from arm_emulator.runs.row_end import RowEnd

IDLE = 0.01  # s, wall: how often an empty ring is looked at
GRACE = 4.0  # s, wall: for the end of its files when the run has died, or after SIGTERM


def main() -> None:
    """Take rows until the run is over; answer what went wrong."""
    end = RowEnd(niceness=5, grace=GRACE)
    task = end.task
    files: list[RecordFile] = []
    try:
        ring = SharedRing(task["memory"], task["kind"])
        show, close_view = _open_view(task)
        if task["record"] is not None:
            files.append(open_record("record", task["record"], task["columns"]))
    except Refusal as no:
        end.send_last_answer(no)
    end.send_answer(None)
    troubles = []
    try:
        _take_all(end, ring, files, show)
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        troubles.append(f"the disk takes no more: {reason}")
    troubles.append(close_view())
    if end.stopped:
        troubles.append("the recorder was ended by SIGTERM")
    end.send_last_answer("; ".join(filter(None, troubles)))


def _take_all(
    end: RowEnd, ring: SharedRing, files: list[RecordFile], show: Callable[[Rows], None]
) -> None:
    """Take rows until input ends.

    Raises:
        OSError: what the disk has refused; the files are whole, or gone.
    """
    over = False
    try:
        while True:
            rows = ring.take_rows()
            if len(rows):
                show(rows)
                for file in files:
                    file.write_rows(rows)
            if end.stopped or (over and not len(rows)):
                break
            if not len(rows):  # rows that were written before the end are there when it is seen
                over = end.is_over(IDLE)
        for file in files:
            file.close()
    except OSError:
        for file in files:
            file.give_up()
        raise


def _open_view(task: dict[str, Any]) -> tuple[Callable[[Rows], None], Callable[[], str]]:
    """Return what shows rows, and what ends the show."""
    if task["rerun"] is None:
        return lambda rows: None, lambda: ""
    os.environ.setdefault("RUST_LOG", "off")  # what Rerun cannot write is reported by `main`
    from arm_emulator.view.rerun_rows import RerunRows

    rows = RerunRows(task["rerun"], task["columns"], task["angle_per_count"], task["view"])
    return rows.show_rows, rows.close


if __name__ == "__main__":
    main()
