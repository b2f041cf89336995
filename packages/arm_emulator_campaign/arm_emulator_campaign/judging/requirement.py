"""A requirement over the signals of a run, as nodes of robustness.c."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from arm_emulator.extension.base import Combined, Formula, Refusal, Window
from arm_emulator.extension.compiler import C_NULL, Header, Library
from arm_emulator.extension.machine import is_at_one_instant

C_FOLDER = Path(__file__).resolve().parents[1] / "c"
ROBUSTNESS = Header(C_FOLDER / "robustness.h")
MAX_NODES = 10_000
_FOREVER = ROBUSTNESS.get_constant("ROBUSTNESS_FOREVER")
_ROUNDING = 1e-6  # of a period: tolerance for times written with few digits


class Robustness:
    """The robustness of a formula over rows of values.

    Attributes:
        pointer: to ``robustness``.

    Args:
        calls: the compiled program.
        formula: over signals that are there.
        row_of: returns the row of the truth value of a formula without windows.
        period: between two samples [s].
        longest: samples that a trace has at most; what reaches further reaches to its end.
        where: for refusals.
        quantity: for refusals.

    Raises:
        Refusal: an interval without a sample in it, or a formula that is too large.
    """

    def __init__(
        self,
        calls: Library,
        formula: Formula,
        row_of: Callable[[Formula], int],
        period: float,
        longest: int,
        where: str = "campaign",
        quantity: str = "requirement",
    ) -> None:
        self._period, self._longest = period, longest
        self._where, self._quantity = where, quantity
        self._row_of = row_of
        self._nodes: list[tuple[int, int, int, int, int]] = []
        self._append_formula(formula)
        rows = ROBUSTNESS.make_rows("robustness_node", len(self._nodes))
        for row, (kind, left, right, begin, end) in zip(rows, self._nodes, strict=True):
            row["kind"], row["left"], row["right"] = kind, left, right
            row["begin"], row["end"] = begin, end
        self._calls = calls
        self.pointer = self._calls.robustness_new(
            ROBUSTNESS.make_pointer("robustness_node", rows), len(rows)
        )
        if self.pointer == C_NULL:
            raise MemoryError("no memory for a requirement")

    def __del__(self) -> None:
        pointer, self.pointer = getattr(self, "pointer", C_NULL), C_NULL
        if pointer:
            self._calls.robustness_delete(pointer)

    def _append_node(
        self, name: str, left: int, right: int = 0, begin: int = 0, end: int = 0
    ) -> int:
        if len(self._nodes) >= MAX_NODES:
            rule = f"have at most {MAX_NODES} operators"
            raise Refusal(self._where, self._quantity, rule, "more")
        kind = ROBUSTNESS.get_constant(f"ROBUSTNESS_{name.upper()}")
        self._nodes.append((kind, left, right, begin, end))
        return len(self._nodes) - 1

    def _append_formula(self, formula: Formula) -> int:
        """Append a formula's nodes, children first; return the last one's place."""
        if is_at_one_instant(formula):
            return self._append_node("atom", self._row_of(formula))
        if isinstance(formula, Combined):
            first = self._append_formula(formula.of[0])
            if formula.sign == "not":
                return self._append_node("not", first)
            for operand in formula.of[1:]:
                first = self._append_node(formula.sign, first, self._append_formula(operand))
            return first
        assert isinstance(formula, Window)
        begin, end = self._find_samples(formula)
        if formula.sign != "until":
            return self._append_node(
                formula.sign, self._append_formula(formula.of[0]), 0, begin, end
            )
        return self._append_until(formula, begin, end)

    def _append_until(self, window: Window, begin: int, end: int) -> int:
        """Append an until; one that begins later is: always before, and from there an until."""
        rest = _FOREVER if end == _FOREVER else end - begin
        until = self._append_node(
            "until", self._append_formula(window.of[0]), self._append_formula(window.of[1]), 0, rest
        )
        if begin == 0:
            return until
        later = self._append_node("eventually", until, 0, begin, begin)
        before = self._append_node("always", self._append_formula(window.of[0]), 0, 0, begin - 1)
        return self._append_node("and", before, later)

    def _find_samples(self, window: Window) -> tuple[int, int]:
        begin = math.ceil(min(window.begin / self._period, 2.0**53) - _ROUNDING)
        last = min(window.end / self._period, 2.0**53)
        end = math.floor(last + _ROUNDING)
        if begin > end:
            rule = f"have intervals with a sample in them, every {self._period:g} s"
            text = f"{window.sign}[{window.begin:g}, {window.end:g}]"
            raise Refusal(self._where, self._quantity, rule, text)
        begin = min(begin, self._longest)
        return begin, _FOREVER if end >= self._longest - 1 else end
