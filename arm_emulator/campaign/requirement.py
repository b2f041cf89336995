"""A requirement over the signals of a run, compiled to a robustness computed during the run."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from arm_emulator.base.refusal import Refusal
from arm_emulator.build.c_header import NULL, Header, Library, pointer
from arm_emulator.build.flags import C_FLAGS
from arm_emulator.build.unit import Unit, library
from arm_emulator.campaign.formula import (
    Combined,
    Constant,
    Expression,
    Formula,
    Margin,
    Operation,
    Signal,
    Window,
)

Array = NDArray[np.float64]
HERE = Path(__file__).resolve().parent
ROBUSTNESS = Header(HERE / "robustness.h")
MOST_NODES = 10_000
_FOREVER = ROBUSTNESS.constant("ROBUSTNESS_FOREVER")
_ROUNDING = 1e-6  # of a period: tolerance for times written with few digits
_ARITHMETIC: dict[str, Callable[[Array, Array], Array]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "min": np.minimum,
    "max": np.maximum,
}


@cache
def _robustness() -> Library:
    return library(robustness_unit())


def robustness_unit() -> Unit:
    """Return the sources of the robustness."""
    part = "robustness.c"
    source, about = f'#include "{part}"\n', "the robustness of requirements"
    return Unit("robustness", source, C_FLAGS, (HERE,), (ROBUSTNESS,), "campaign", about, part)


def signals_in(what: Formula | Expression) -> set[str]:
    """Return the names of all signals."""
    if isinstance(what, Signal):
        return {what.name}
    if isinstance(what, Constant):
        return set()
    of = (what.of,) if isinstance(what, Margin) else what.of
    return set().union(*map(signals_in, of))


def value_of(what: Expression, signals: Mapping[str, Array]) -> Array | float:
    """Return arithmetic of signals (K,)."""
    if isinstance(what, Constant):
        return what.value
    if isinstance(what, Signal):
        return signals[what.name]
    values = [value_of(one, signals) for one in what.of]
    if what.sign in ("abs", "sqrt"):
        return np.abs(values[0]) if what.sign == "abs" else np.sqrt(values[0])
    return functools.reduce(_ARITHMETIC[what.sign], values)  # type: ignore[arg-type]


def bound_to(what: Formula, known: Iterable[str], where: str, quantity: str) -> Formula:
    """Return a formula over known signals: a comparison with a ``*`` holds for each that it means.

    Raises:
        Refusal: a signal that is not known.
    """
    known = list(known)
    if isinstance(what, Margin):
        each = [Margin(one) for one in meant_by(what.of, known, where, quantity)]
        return each[0] if len(each) == 1 else Combined("and", tuple(each))
    of = tuple(bound_to(one, known, where, quantity) for one in what.of)
    if isinstance(what, Combined):
        return Combined(what.sign, of)
    return Window(what.sign, of, what.begin, what.end)


def meant_by(what: Expression, known: Sequence[str], where: str, quantity: str) -> list[Expression]:
    """Return the arithmetic for each text that the ``*`` in names of signals stands for.

    Raises:
        Refusal: a signal that is not known, or no text that fits all.
    """
    names = sorted(signals_in(what))
    stars = [name for name in names if "*" in name]
    for name in names:
        if name not in stars and name not in known:
            raise _unknown(name, known, where, quantity)
    if not stars:
        return [what]
    fitting: list[list[str]] = []
    for name in stars:
        pattern = re.compile(re.escape(name).replace(r"\*", r"(.+)"))
        texts = [found[1] for one in known if (found := pattern.fullmatch(one))]
        if not texts:
            raise _unknown(name, known, where, quantity)
        fitting.append(texts)
    common = [text for text in fitting[0] if all(text in texts for texts in fitting[1:])]
    if not common:
        raise _unknown(", ".join(stars), known, where, quantity)
    return [_with_text(what, text) for text in common]


def _with_text(what: Expression, text: str) -> Expression:
    if isinstance(what, Signal):
        return Signal(what.name.replace("*", text))
    if isinstance(what, Constant):
        return what
    return Operation(what.sign, tuple(_with_text(one, text) for one in what.of))


def _unknown(name: str, known: Sequence[str], where: str, quantity: str) -> Refusal:
    import difflib

    first = sorted({one.rpartition(".")[0] + ".*" if "." in one else one for one in known})
    near = difflib.get_close_matches(name, known, n=3) or first
    return Refusal(where, quantity, "name signals of the run", name, ", ".join(near))


class Robustness:
    """The robustness of a formula, which takes the signals piece by piece.

    Args:
        formula: over signals that are there.
        period: between two samples [s].
        longest: samples that a trace has at most; what reaches further reaches to its end.
        where: for refusals.
        quantity: for refusals.

    Raises:
        Refusal: an interval without a sample in it, or a formula that is too large.
    """

    def __init__(
        self,
        formula: Formula,
        period: float,
        longest: int,
        where: str = "campaign",
        quantity: str = "requirement",
    ) -> None:
        self._period, self._longest = period, longest
        self._where, self._quantity = where, quantity
        self.margins: list[Expression] = []
        self._nodes: list[tuple[int, int, int, int, int]] = []
        self._add(formula)
        rows = ROBUSTNESS.rows("robustness_node", len(self._nodes))
        for row, (kind, left, right, begin, end) in zip(rows, self._nodes, strict=True):
            row["kind"], row["left"], row["right"] = kind, left, right
            row["begin"], row["end"] = begin, end
        self._calls = _robustness()
        self._one = self._calls.robustness_new(
            ROBUSTNESS.pointer("robustness_node", rows), len(rows)
        )
        if self._one == NULL:
            raise MemoryError("no memory for a requirement")

    def __del__(self) -> None:
        one, self._one = getattr(self, "_one", NULL), NULL
        if one:
            self._calls.robustness_delete(one)

    def feed(self, signals: Mapping[str, Array], count: int) -> None:
        """Add samples of the signals (K,)."""
        atoms = np.empty((len(self.margins), count))
        for row, margin in zip(atoms, self.margins, strict=True):
            row[:] = value_of(margin, signals)
        if self._calls.robustness_feed(self._one, pointer(atoms), count, count):
            raise MemoryError("no memory for a requirement")

    def end(self) -> float:
        """Return the robustness of the trace, and restart."""
        return float(self._calls.robustness_end(self._one))

    def _put(self, name: str, left: int, right: int = 0, begin: int = 0, end: int = 0) -> int:
        if len(self._nodes) >= MOST_NODES:
            rule = f"have at most {MOST_NODES} operators"
            raise Refusal(self._where, self._quantity, rule, "more")
        kind = ROBUSTNESS.constant(f"ROBUSTNESS_{name.upper()}")
        self._nodes.append((kind, left, right, begin, end))
        return len(self._nodes) - 1

    def _add(self, what: Formula) -> int:
        """Append a formula's nodes, children first; return the last one's place."""
        if isinstance(what, Margin):
            self.margins.append(what.of)
            return self._put("atom", len(self.margins) - 1)
        if isinstance(what, Combined):
            first = self._add(what.of[0])
            if what.sign == "not":
                return self._put("not", first)
            for one in what.of[1:]:
                first = self._put(what.sign, first, self._add(one))
            return first
        begin, end = self._samples(what)
        if what.sign != "until":
            return self._put(what.sign, self._add(what.of[0]), 0, begin, end)
        return self._until(what, begin, end)

    def _until(self, what: Window, begin: int, end: int) -> int:
        """Append an until; one that begins later is: always before, and from there an until."""
        rest = _FOREVER if end == _FOREVER else end - begin
        until = self._put("until", self._add(what.of[0]), self._add(what.of[1]), 0, rest)
        if begin == 0:
            return until
        later = self._put("eventually", until, 0, begin, begin)
        before = self._put("always", self._add(what.of[0]), 0, 0, begin - 1)
        return self._put("and", before, later)

    def _samples(self, what: Window) -> tuple[int, int]:
        begin = math.ceil(min(what.begin / self._period, 2.0**53) - _ROUNDING)
        last = min(what.end / self._period, 2.0**53)
        end = math.floor(last + _ROUNDING)
        if begin > end:
            rule = f"have intervals with a sample in them, every {self._period:g} s"
            got = f"{what.sign}[{what.begin:g}, {what.end:g}]"
            raise Refusal(self._where, self._quantity, rule, got)
        begin = min(begin, self._longest)
        return begin, _FOREVER if end >= self._longest - 1 else end
