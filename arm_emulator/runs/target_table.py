"""Joint targets from a table: a CSV file with the columns `t` and the joints' names."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from arm_emulator.base.bound import POSITION
from arm_emulator.base.given import FloatArray
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.table_file import Table, read_table

RowCheck = Callable[[str, Sequence[str], FloatArray, FloatArray], None]

LATEST = 1e9  # s
_ROUNDING = 1e-6  # of a period: a time that was written with a few digits is that of its tick


@dataclass(frozen=True)
class TargetTable:
    """Joint targets that hold from their time until the next one's.

    Attributes:
        t: times, ascending (K,) [s].
        q: in the order of the joints that were asked for (K, N) [rad or m].
    """

    t: npt.NDArray[np.float64]
    q: npt.NDArray[np.float64]

    @property
    def seconds(self) -> float | None:
        """Its duration, with a last row as long as the previous one; None: it has one row."""
        return float(2.0 * self.t[-1] - self.t[-2]) if len(self.t) > 1 else None

    def ticks(self, period: float) -> list[int]:
        """Return the tick from which on each row holds: the first one not before its time."""
        return [math.ceil(t / period - _ROUNDING) for t in self.t.tolist()]


def load_target_table(
    file: Path, joint_names: Sequence[str], check: RowCheck | None = None
) -> TargetTable:
    """Read a table.

    Args:
        file: the CSV file.
        joint_names: joints of its columns, in the order of the result.
        check: refuses targets beyond an arm's limits, given the file's name, the names of the rows,
            and times and targets in that order; None: the numbers are no targets of an arm.

    Raises:
        Refusal: no such file, other columns, a row with a gap, a value that is no number or too
            large, times that do not ascend from 0 s or later, or what `check` refuses.
    """
    wanted = ["t", *joint_names]
    units = {name: "rad or m" for name in joint_names} | {"t": "s"}
    table = read_table(file, units)
    if sorted(table.columns) != sorted(wanted):
        rule = "be t and every joint of the scene once"
        got = ", ".join(table.columns) or "none"
        raise Refusal(table.where, "columns", rule, got, ", ".join(wanted))
    numbers = table.values[:, [table.columns.index(name) for name in wanted]]
    if not len(numbers):
        raise Refusal(table.where, "table", "have a row of targets", "none")
    _check(numbers, table, wanted)
    if check is not None:
        check(table.where, [f"line {line}" for line in table.lines], numbers[:, 0], numbers[:, 1:])
    return TargetTable(numbers[:, 0], numbers[:, 1:])


def _check(numbers: FloatArray, table: Table, names: Sequence[str]) -> None:
    """Refuse gaps, times that do not ascend and angles that are not finite, with their lines."""
    t, q = numbers[:, 0], numbers[:, 1:]
    for row, column in np.argwhere(np.isnan(numbers))[:1]:
        what = f"line {table.lines[row]}, {names[column]}"
        unit = "rad or m" if column else "s"
        raise Refusal(table.where, what, f"be a number [{unit}]", "nothing")
    for row in np.flatnonzero((t < 0.0) | (t > LATEST))[:1]:
        rule = f"be from 0 to {LATEST:g} s"
        raise Refusal(table.where, f"line {table.lines[row]}, t", rule, t[row])
    for row in np.flatnonzero(np.diff(t) <= 0.0)[:1] + 1:
        rule = f"be later than the previous row's, {t[row - 1]:g} s"
        raise Refusal(table.where, f"line {table.lines[row]}, t", rule, f"{t[row]:g} s")
    for row, column in np.argwhere(np.abs(q) > POSITION.most)[:1]:
        rule = f"be within +-{POSITION.most:g} rad or m"
        what = f"line {table.lines[row]}, {names[column + 1]}"
        raise Refusal(table.where, what, rule, q[row, column])
