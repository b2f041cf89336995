"""A formula as rows of core/boundary/formula.h, and the library that computes them."""

import functools
from collections.abc import Callable, Sequence
from typing import Any

from numpy.typing import NDArray

from arm_emulator.base.expression.formula import (
    Combined,
    Constant,
    Expression,
    Formula,
    Margin,
    Signal,
    Window,
    fold_expression,
)
from arm_emulator.core import BOUNDARY
from arm_emulator.tick.c import FOLDER, FOLDERS
from arm_emulator.toolchain.c_header import Header
from arm_emulator.toolchain.compile_unit import compile_once
from arm_emulator.toolchain.flags import C_FLAGS
from arm_emulator.toolchain.unit import Unit

Row = tuple[str, int, int, float]
_KINDS = {
    "+": "ADD",
    "-": "SUBTRACT",
    "*": "MULTIPLY",
    "/": "DIVIDE",
    "min": "LEAST_OF",
    "max": "LARGEST_OF",
    "abs": "ABS",
    "sqrt": "SQRT",
}


class FormulaRows:
    """Rows of values, each of which is computed once whatever formulas ask for it.

    Args:
        row_of_signal: row of a signal, by its name, from `add_input` or `add_expression`.
    """

    def __init__(self, row_of_signal: Callable[[str], int]) -> None:
        self._row_of_signal = row_of_signal
        self._rows: dict[Row, int] = {}

    def __len__(self) -> int:
        return len(self._rows)

    def add_input(self, place: int) -> int:
        """Return the row of an input, by its place among those that the caller measures."""
        return self._add_row("INPUT", place)

    def add_expression(self, expression: Expression) -> int:
        """Return the row of arithmetic."""
        return fold_expression(expression, self._add_part)

    def add_formula(self, formula: Formula) -> int:
        """Return the row of the truth value of a formula at one instant, without windows."""
        assert not isinstance(formula, Window), "a window is no row"
        if isinstance(formula, Margin):
            return self._add_row(
                "ABOVE" if formula.strict else "AT_LEAST", *map(self.add_expression, formula.sides)
            )
        parts = [self.add_formula(part) for part in formula.of]
        if formula.sign == "not":
            return self._add_row("NOT", parts[0], parts[0])
        return self._join_rows(formula.sign.upper(), parts)

    def make_struct(self) -> NDArray[Any]:
        """Return them as ``formula_row``, one at least."""
        rows = FORMULA.make_rows("formula_row", max(1, len(self._rows)))
        for row, (kind, left, right, value) in zip(rows, self._rows, strict=False):
            row["kind"] = FORMULA.get_constant(f"FORMULA_{kind}")
            row["left"], row["right"], row["value"] = left, right, value
        return rows

    def _add_part(self, part: Expression, operands: Sequence[int]) -> int:
        if isinstance(part, Constant):
            return self._add_row("CONSTANT", value=part.value)
        if isinstance(part, Signal):
            return self._row_of_signal(part.name)
        kind = _KINDS[part.sign]
        if len(operands) == 1:
            return self._add_row(kind, operands[0], operands[0])
        return self._join_rows(kind, operands)

    def _join_rows(self, kind: str, rows: Sequence[int]) -> int:
        """Return the row of an operation on several rows, from the first one on."""
        return functools.reduce(lambda left, right: self._add_row(kind, left, right), rows)

    def _add_row(self, kind: str, left: int = 0, right: int = 0, value: float = 0.0) -> int:
        return self._rows.setdefault((kind, left, right, value), len(self._rows))


def is_at_one_instant(formula: Formula) -> bool:
    """Return whether a formula has no windows."""
    if isinstance(formula, Combined):
        return all(map(is_at_one_instant, formula.of))
    return isinstance(formula, Margin)


FORMULA = Header(BOUNDARY / "formula.h")
TOOL_POSITION = Header(BOUNDARY / "tool_position.h")
CONDITION = Header(FOLDER / "condition.h", FOLDERS)


def build_formula_unit() -> Unit:
    """Return the sources of formulas, tool positions, conditions and breakpoints."""
    parts = "formula.c", "tool_position.c", "condition.c"
    source = "".join(f'#include "{part}"\n' for part in parts)
    headers = FORMULA, TOOL_POSITION, CONDITION
    about = "formulas and conditions"
    return Unit("formula", source, C_FLAGS, FOLDERS, headers, "formula", about, parts[0])


formula_library = compile_once(build_formula_unit)
