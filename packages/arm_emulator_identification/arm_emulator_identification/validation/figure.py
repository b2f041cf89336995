"""Figures of a validation, each with its limit.

Table and exit code come from the same list of these, so that every figure shown counts.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from rich.table import Table

from arm_emulator.extension.base import Array


@dataclass(frozen=True)
class Figure:
    """A quantity of each axis, or a single one, and its limit.

    A yardstick (the figure of a null model) has no limit of its own: others are compared with it.
    """

    title: str
    values: Array
    """(N,); NaN of an axis that is not judged."""
    form: str
    """Format of one value, such as ``.1f``."""
    least: float = -np.inf
    """Least value that every axis must have."""
    most: float = np.inf
    min_mean: float = -np.inf
    max_mean: float = np.inf
    needed: Sequence[int] = field(default=())
    """Axes that must have a value."""
    yardstick: bool = False
    overall: float | None = None
    """In place of the mean."""

    @property
    def mean(self) -> float:
        """Overall value, or the mean of the axes that have a value; NaN if none has."""
        if self.overall is not None:
            return self.overall
        finite = self.values[np.isfinite(self.values)]
        return float(finite.mean()) if finite.size else np.nan

    @property
    def failures(self) -> Iterator[str]:
        """Yield each limit that is not kept, as a line."""
        if self.yardstick:
            return
        for axis in self.needed:
            if not np.isfinite(self.values[axis]):
                yield f"{self.title}: axis {axis + 1} must have a value, got none"
        finite = [(k, v) for k, v in enumerate(self.values) if np.isfinite(v)]
        for k, value in finite:
            if not self.least <= value <= self.most:
                rule = self._format_rule(self.least, self.most)
                yield f"{self.title}: axis {k + 1} must be {rule}, got {value:{self.form}}"
        if finite and not self.min_mean <= self.mean <= self.max_mean:
            rule = self._format_rule(self.min_mean, self.max_mean)
            yield f"{self.title}: the mean must be {rule}, got {self.mean:{self.form}}"

    @staticmethod
    def _format_rule(low: float, high: float) -> str:
        ends = ((f">= {low:g}", np.isfinite(low)), (f"<= {high:g}", np.isfinite(high)))
        return " and ".join(text for text, is_bounded in ends if is_bounded)

    @property
    def limits(self) -> str:
        """The limits as text."""
        if self.yardstick:
            return "null model"
        each, mean = (
            self._format_rule(self.least, self.most),
            self._format_rule(self.min_mean, self.max_mean),
        )
        return "; ".join(filter(None, (each, mean and f"mean {mean}")))


def format_table(title: str, names: Sequence[str], figures: Sequence[Figure]) -> Table:
    """Return figures of axes as a table, failures in red."""
    table = Table(title=title)
    table.add_column("")
    for name in (*names, "mean", "must be"):
        table.add_column(name, justify="right")
    for figure in figures:
        cells = [format(v, figure.form) if np.isfinite(v) else "" for v in figure.values]
        mean = format(figure.mean, figure.form) if np.isfinite(figure.mean) else ""
        style = "red" if any(figure.failures) else "dim" if figure.yardstick else None
        table.add_row(figure.title, *cells, mean, figure.limits, style=style)
    return table
