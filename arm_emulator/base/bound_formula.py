"""Formulas over known signals: names are checked, and a ``*`` stands for each that fits."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence

from arm_emulator.base.formula import (
    Combined,
    Expression,
    Formula,
    Margin,
    Operation,
    Signal,
    Window,
    fold,
)
from arm_emulator.base.refusal import Refusal


def signals_in(what: Formula | Expression) -> set[str]:
    """Return the names of all signals."""
    if isinstance(what, Margin):
        return set().union(*map(signals_in, what.sides))
    if isinstance(what, Combined | Window):
        return set().union(*map(signals_in, what.of))
    names: set[str] = set()

    def add(part: Expression, _: object) -> None:
        if isinstance(part, Signal):
            names.add(part.name)

    fold(what, add)
    return names


def bound_to(what: Formula, known: Iterable[str], where: str, quantity: str) -> Formula:
    """Return a formula over known signals: a comparison with a ``*`` holds for each that it means.

    Raises:
        Refusal: a signal that is not known.
    """
    known = list(known)
    if isinstance(what, Margin):
        # A text for a star is the same on both sides.
        both = meant_by(Operation("-", what.sides), known, where, quantity)
        sides = [one.of for one in both if isinstance(one, Operation)]
        each = [Margin(more, less, what.strict) for more, less in sides]
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
    def put(part: Expression, operands: Sequence[Expression]) -> Expression:
        if isinstance(part, Signal):
            return Signal(part.name.replace("*", text))
        return Operation(part.sign, tuple(operands)) if isinstance(part, Operation) else part

    return fold(what, put)


def _unknown(name: str, known: Sequence[str], where: str, quantity: str) -> Refusal:
    first = sorted({one.rpartition(".")[0] + ".*" if "." in one else one for one in known})
    near = difflib.get_close_matches(name, known, n=3) or first
    return Refusal(where, quantity, "name signals of the run", name, ", ".join(near))
