"""The part of a run that a page shows, with the history of its signals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.machine import RecordRow, list_columns
from arm_emulator.extension.page import Timeline
from arm_emulator_page.signal_plot import group_columns


@dataclass(frozen=True)
class RunView:
    """A run up to some tick.

    Attributes:
        line: timeline of a run with `session`.
        last: last tick that can be visited.
        history: signals up to there.
        events: ticks and texts of what happened.
    """

    line: Timeline[Any]
    last: int
    history: SignalHistory
    events: tuple[tuple[int, str], ...]

    @classmethod
    def create_from_line(
        cls, line: Timeline[Any], last: int, events: tuple[tuple[int, str], ...] | None = None
    ) -> RunView:
        """Return a run from its first tick on; its events are its changes if none are given."""
        at = line.tick
        line.go_to(line.first)
        history = SignalHistory(line, last)
        line.go_to(at)
        event_rows = (
            tuple((change.tick, change.name) for change in line.changes)
            if events is None
            else events
        )
        return cls(line, last, history, event_rows)


MAX_SAMPLES = 2000  # samples of a plot


class SignalHistory:
    """Rows of a machine at some ticks of a run.

    Attributes:
        ticks: of the samples (K,).
        groups: quantities with their columns, such as "q".

    Args:
        line: timeline of a run with `session`, at its first tick; afterwards at the last.
        last: its last tick.
    """

    def __init__(self, line: Timeline[Any], last: int) -> None:
        every = max(1, -(-last // MAX_SAMPLES))
        row = RecordRow(line.run.session.plant)
        rows, ticks = [row.take_row()], [line.tick]
        while line.tick < last:
            line.advance(min(every, last - line.tick))
            rows.append(row.take_row())
            ticks.append(line.tick)
        self.ticks = np.array(ticks)
        self._rows = np.concatenate(rows)
        self.groups = group_columns(list_columns(line.run.session.scene))

    def read_values(self, group: str) -> NDArray[np.float64]:
        """Return a quantity at all samples (K, columns)."""
        columns = [
            column.select_values(self._rows).astype(np.float64) for column in self.groups[group]
        ]
        return np.stack(columns, axis=1)

    def list_paths(self, group: str) -> list[tuple[str, ...]]:
        """Return the names of a quantity's columns; empty: the run has no such quantity."""
        return [tuple(column.path) for column in self.groups.get(group, ())]

    def subtract_history(
        self, another: SignalHistory, group: str
    ) -> tuple[NDArray[Any], NDArray[np.float64]]:
        """Return ticks that both have (K,), and the quantity there minus that of the other."""
        ticks, here, there = np.intersect1d(self.ticks, another.ticks, return_indices=True)
        return ticks, self.read_values(group)[here] - another.read_values(group)[there]
