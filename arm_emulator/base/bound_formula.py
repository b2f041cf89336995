"""Formulas over known signals: names are checked, and a ``*`` stands for each that fits."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence

from arm_emulator.base.formula import (
    Combined,
    Constant,
    Expression,
    Formula,
    Margin,
    Operation,
    Signal,
    Window,
)
from arm_emulator.base.refusal import Refusal


def signals_in(what: Formula | Expression) -> set[str]:
    """Return the names of all signals."""
    if isinstance(what, Signal):
        return {what.name}
    if isinstance(what, Constant):
        return set()
    of = (what.of,) if isinstance(what, Margin) else what.of
    return set().union(*map(signals_in, of))


def bound_to(what: Formula, known: Iterable[str], where: str, quantity: str) -> Formula:
    """Return a formula over known signals: a comparison with a ``*`` holds for each that it means.

    Raises:
        Refusal: a signal that is not known.
    """
    known = list(known)
    if isinstance(what, Margin):
        each = [Margin(one, what.strict) for one in meant_by(what.of, known, where, quantity)]
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
    first = sorted({one.rpartition(".")[0] + ".*" if "." in one else one for one in known})
    near = difflib.get_close_matches(name, known, n=3) or first
    return Refusal(where, quantity, "name signals of the run", name, ", ".join(near))
