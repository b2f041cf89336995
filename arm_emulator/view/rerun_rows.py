"""Rows of a run shown in Rerun."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.base.column import Column, Rows
from arm_emulator.view.rerun_stream import RerunStream

NANOSECONDS = 1_000_000_000


class RerunRows:
    """Shows all rows, at the pace of Rerun.

    Args:
        where: the port at which a viewer may connect, or an .rrd file.
        columns: of the rows.
        angle_per_count: of the encoders (N,) [rad or m].
        view: further arguments of `RerunStream`.

    Raises:
        Refusal: see `RerunStream`.
    """

    def __init__(
        self,
        where: str,
        columns: Sequence[Column],
        angle_per_count: NDArray[np.float64],
        view: Mapping[str, Any],
    ) -> None:
        place = {"port": int(where)} if where.isdecimal() else {"file": where}
        self._stream = RerunStream(**view, **place, targets=False)
        self._angle_per_count = angle_per_count
        self._columns: dict[str, list[Column]] = {}
        for column in columns:
            self._columns.setdefault(".".join(column.path[:-1]), []).append(column)
        self._further = list(view["further"])

    def _stack_columns(self, rows: Rows, group: str) -> NDArray[np.float64]:
        return np.column_stack(
            [column.select_values(rows) for column in self._columns[group]]
        ).astype(np.float64)

    def show_rows(self, rows: Rows) -> None:
        """Show rows (K,)."""
        counts = self._stack_columns(rows, "measured.encoder_counts")
        quantities = [
            *(self._stack_columns(rows, name) for name in ("q", "v", "gear_torque", "current")),
            self._stack_columns(rows, "measured.applied"),
            (counts + 0.5) * self._angle_per_count,
            *(self._stack_columns(rows, f"measured.{name}") for name in self._further),
        ]
        times = np.rint(rows["t"] * NANOSECONDS).astype(np.int64).tolist()
        for time_ns, *sample in zip(times, *quantities, strict=True):
            self._stream.wait_for_room()
            q, v, torque, current, applied, measured, *further = sample
            self._stream.show_state(time_ns, q, v, torque, current, applied, measured, further)

    def close(self) -> str:
        """Write the waiting rows; return what is missing, or ""."""
        return self._stream.close_complete()
