"""Joint targets from a table: a CSV file with the columns `t` and the joints' names."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from words.bound import POSITION
from words.refusal import Refusal
from words.text_file import read_bytes

LARGEST = 2**28  # bytes
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
        """How long it lasts: its last row as long as the one before; None: it has one row."""
        return float(2.0 * self.t[-1] - self.t[-2]) if len(self.t) > 1 else None

    def ticks(self, period: float) -> list[int]:
        """Return the tick from which on each row holds: the first one not before its time."""
        return [math.ceil(t / period - _ROUNDING) for t in self.t.tolist()]


def load_target_table(file: Path, joint_names: Sequence[str]) -> TargetTable:
    """Read a table.

    Raises:
        Refusal: no such file, other columns, a row with a gap, a value that is no number or too
            large, or times that do not ascend from 0 s or later.
    """
    where = file.name
    rows = _rows(file)
    line, head = next(rows, (1, []))
    columns = [cell.strip() for cell in head]
    wanted = ["t", *joint_names]
    if sorted(columns) != sorted(wanted):
        rule = "be t and every joint of the scene once"
        raise Refusal(where, "columns", rule, ", ".join(columns) or "none", ", ".join(wanted))
    order = [columns.index(name) for name in wanted]
    values: list[list[float]] = []
    for line, cells in rows:
        if len(cells) != len(columns):
            rule = f"have {len(columns)} values, as the columns"
            raise Refusal(where, f"line {line}", rule, len(cells))
        row = [_number(cells[k], where, line, columns[k]) for k in order]
        _check(row, values, where, line, wanted)
        values.append(row)
    if not values:
        raise Refusal(where, "table", "have a row of targets", "none")
    numbers = np.array(values)
    return TargetTable(numbers[:, 0], numbers[:, 1:])


def _rows(file: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the lines that are not empty, with their numbers."""
    try:
        text = read_bytes(file, LARGEST).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise Refusal(file.name, "file", "be text in UTF-8", error.reason) from None
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        for cells in reader:
            if cells:
                yield reader.line_num, cells
    except csv.Error as error:
        raise Refusal(file.name, f"line {reader.line_num}", "be well-formed CSV", error) from None


def _number(cell: str, where: str, line: int, column: str) -> float:
    try:
        value = float(cell) if "_" not in cell else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        unit = "s" if column == "t" else "rad or m"
        raise Refusal(where, f"line {line}, {column}", f"be a number [{unit}]", cell or "nothing")
    return value


def _check(
    row: list[float], before: list[list[float]], where: str, line: int, columns: list[str]
) -> None:
    t = row[0]
    if not 0.0 <= t <= LATEST:
        raise Refusal(where, f"line {line}, t", f"be from 0 to {LATEST:g} s", t)
    if before and t <= before[-1][0]:
        rule = f"be later than that of the row before, {before[-1][0]:g} s"
        raise Refusal(where, f"line {line}, t", rule, f"{t:g} s")
    for name, q in zip(columns[1:], row[1:], strict=True):
        if abs(q) > POSITION.largest:
            rule = f"be within +-{POSITION.largest:g} rad or m"
            raise Refusal(where, f"line {line}, {name}", rule, q)
