"""Tables from outside: a CSV file with a heading and rows of numbers."""

import csv
import io
import math
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.io.text_file import read_text
from arm_emulator.base.refusal import Refusal

MAX_BYTES = 2**28
MAX_COLUMNS = 1000
LONGEST_LINE = 2**16  # characters
_WRONG_MARKS = {";": "semicolons", "\t": "tabs"}  # between columns, as spreadsheets write them


@dataclass(frozen=True)
class Table:
    """Numbers in columns.

    Attributes:
        where: name of the file.
        columns: their names (C,).
        lines: line number of each row in the file, from 1 on (K,).
        values: NaN where a cell is empty (K, C).
    """

    where: str
    columns: tuple[str, ...]
    lines: tuple[int, ...]
    values: Array

    def get_column(self, name: str) -> Array:
        """Return the values below a name (K,)."""
        column: Array = self.values[:, self.columns.index(name)]
        return column


def read_table(file: Path, units: Mapping[str, str]) -> Table:
    """Read a table; empty lines are skipped.

    Args:
        file: the CSV file.
        units: of columns, by their names, for refusals.

    Raises:
        Refusal: the file is missing or not a CSV in UTF-8; a row is shorter or longer than the
            heading; a cell is not a finite number.
    """
    where = file.name
    rows = _read_rows(file)
    _, head = next(rows, (1, []))
    columns = tuple(cell.strip() for cell in head)
    for mark, name in _WRONG_MARKS.items():
        if len(columns) == 1 and mark in columns[0]:
            rule = "separate columns by commas"
            raise Refusal(where, "heading", rule, name, "commas, and points in decimal numbers")
    if len(columns) > MAX_COLUMNS:
        raise Refusal(where, "heading", f"have at most {MAX_COLUMNS} columns", len(columns))
    values, lines = array("d"), array("q")
    for line, cells in rows:
        if len(cells) != len(columns):
            rule = f"have {len(columns)} values, as the columns"
            raise Refusal(where, f"line {line}", rule, len(cells))
        lines.append(line)
        for name, cell in zip(columns, cells, strict=True):
            values.append(_parse_number(cell, f"line {line}, {name}", units.get(name), where))
    numbers = np.array(values, dtype=np.float64).reshape(len(lines), len(columns))
    return Table(where, columns, tuple(lines), numbers)


def _read_rows(file: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the lines that are not empty, with their numbers."""
    text = io.StringIO(read_text(file, MAX_BYTES), newline="")
    reader = csv.reader(_check_size(text, file.name), strict=True)
    try:
        for cells in reader:
            if cells:
                yield reader.line_num, cells
    except csv.Error as error:
        raise Refusal(file.name, f"line {reader.line_num}", "be well-formed CSV", error) from None


def _check_size(text: io.StringIO, where: str) -> Iterator[str]:
    number = 0
    while line := text.readline(LONGEST_LINE + 1):
        number += 1
        if len(line) > LONGEST_LINE:
            rule = f"have at most {LONGEST_LINE} characters"
            raise Refusal(where, f"line {number}", rule, "more")
        yield line


def _parse_number(cell: str, quantity: str, unit: str | None, where: str) -> float:
    if not cell or cell.isspace():
        return math.nan
    try:
        value = float(cell) if "_" not in cell else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise Refusal(where, quantity, f"be a number [{unit}]" if unit else "be a number", cell)
    return value
