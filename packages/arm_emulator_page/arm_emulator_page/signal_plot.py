"""A plot of one quantity of a machine, all joints together."""

import itertools
from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np

from arm_emulator.extension.base import Column, ColumnRows

COLORS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f")
FIRST = "q"  # quantity of the first plot
HEIGHT = 260  # px
SCALES: dict[str, Any] = {"x": {"time": False}}  # of seconds, which are no date


def group_columns(columns: Sequence[Column]) -> dict[str, list[Column]]:
    """Return the columns of each quantity, such as "measured.current"."""
    groups: dict[str, list[Column]] = {}
    for column in columns:
        if len(column.path) > 1:
            groups.setdefault(".".join(column.path[:-1]), []).append(column)
    return groups


def make_line_styles(columns: Sequence[Column]) -> tuple[Any, ...]:
    """Return how the columns of a quantity are drawn over time."""
    lines: list[dict[str, Any]] = [{"label": "t [s]"}]
    lines += [
        {"label": f"{column.path[-1]} [{column.unit}]", "stroke": color, "width": 1.5}
        for column, color in zip(columns, itertools.cycle(COLORS), strict=False)
    ]
    return tuple(lines)


class SignalPlot:
    """A plot with the choice of its quantity, in the tab in whose context it is made.

    Args:
        gui: of the server.
        columns: of the rows.
        changed: is called when another quantity is chosen.
    """

    def __init__(self, gui: Any, columns: Sequence[Column], changed: Callable[[], None]) -> None:
        self._groups = group_columns(columns)
        self._choice = gui.add_dropdown("Signal", tuple(self._groups), initial_value=FIRST)
        self._choice.on_update(lambda _: changed())
        self._plotted = FIRST
        lines = make_line_styles(self._groups[FIRST])
        empty = tuple(np.zeros(0) for _ in lines)
        self._chart = gui.add_uplot(empty, lines, scales=SCALES, height=HEIGHT)

    @property
    def data(self) -> tuple[Any, ...]:
        """Times [s] and the columns that are plotted over them."""
        data: tuple[Any, ...] = self._chart.data
        return data

    def show_rows(self, rows: ColumnRows) -> None:
        """Plot the chosen quantity of rows (K,)."""
        group = read_choice(self._choice, self._groups)
        columns = self._groups[group]
        values = [column.select_values(rows).astype(np.float64) for column in columns]
        data = (rows["t"].astype(np.float64), *values)
        if group == self._plotted:
            self._chart.data = data
            return
        self._plotted = group
        self._chart.data, self._chart.series = data, make_line_styles(columns)


def read_choice(control: Any, values: Collection[str]) -> str:
    """Return the value of a dropdown; the first known one replaces any other value."""
    value = str(control.value)
    if value not in values:
        control.value = value = next(iter(values))
    return value
