"""Units of what a campaign judges, from those of its signals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from arm_emulator.base.bound_formula import bound_to
from arm_emulator.base.formula import (
    Constant,
    Expression,
    Formula,
    Margin,
    Signal,
    fold,
    parse_formula,
)
from arm_emulator.campaign.campaign_file import Campaign
from arm_emulator.campaign.judges import Measure
from arm_emulator.campaign.signals import units_of_signals

_KEEPS = ("+", "-", "abs", "min", "max")  # operations whose result has the unit of their operands


def judged_units(campaign: Campaign) -> tuple[dict[str, str], dict[str, str]]:
    """Return the units of robustness and of measures, by name.

    "": a number, several units, or a function of Python.
    """
    units, where = units_of_signals(campaign.scene), campaign.where
    robustness = {}
    for name, text in campaign.requirements.items():
        found = None
        if isinstance(text, str):
            formula = parse_formula(text, where, name)
            found = of_formula(bound_to(formula, list(units), where, name), units)
        robustness[name] = found or ""
    measures = {}
    for name, text in campaign.measures.items():
        one = Measure(text, list(units), where, name)
        measures[name] = _common(of_expression(each, units) for each in one.of) or ""
    return robustness, measures


def of_formula(what: Formula, units: Mapping[str, str]) -> str | None:
    """Return the unit of a formula's robustness; None: it has constants alone."""
    if isinstance(what, Margin):
        return _common(of_expression(side, units) for side in what.sides)
    return _common(of_formula(one, units) for one in what.of)


def of_expression(what: Expression, units: Mapping[str, str]) -> str | None:
    """Return the unit of arithmetic; None: of a constant, which has any."""

    def unit(part: Expression, of: Sequence[str | None]) -> str | None:
        if isinstance(part, Constant):
            return None
        if isinstance(part, Signal):
            return units[part.name]
        if part.sign in _KEEPS:
            return _common(of)
        if part.sign == "*":
            return of[0] if of[1] is None else of[1] if of[0] is None else ""
        if part.sign == "/" and of[1] is None:
            return of[0]
        return None if all(one is None for one in of) else ""

    return fold(what, unit)


def _common(several: Iterable[str | None]) -> str | None:
    """Return the unit that all have which have one; "": they differ."""
    known = {one for one in several if one is not None}
    return None if not known else known.pop() if len(known) == 1 else ""
