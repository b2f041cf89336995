"""Judges of a run: requirements, measures, and functions of Python over the whole trace."""

from __future__ import annotations

import importlib.util
import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.section import Section
from arm_emulator.campaign.campaign_file import Campaign
from arm_emulator.campaign.formula import Expression, parse_expression, parse_formula
from arm_emulator.campaign.requirement import (
    Robustness,
    bound_to,
    meant_by,
    signals_in,
    value_of,
)
from arm_emulator.campaign.scenario import ticks_of
from arm_emulator.campaign.signals import units_of_signals

Array = NDArray[np.float64]
Signals = Mapping[str, Array]
REDUCTIONS = ("max", "min", "mean", "rms", "last")
_MEASURE = re.compile(r"\s*(\w+)\s*\((.*)\)\s*", re.DOTALL)


class Measure:
    """A number of a run: the maximum, minimum, mean, root mean square or last value of arithmetic.

    Args:
        text: such as ``max(abs(measured.current.elbow))``; a ``*`` takes the largest, or for
            ``min`` the smallest, of all that it means.
        known: signals.
        where: for refusals.
        quantity: for refusals.

    Raises:
        Refusal: an unknown form.
    """

    def __init__(self, text: str, known: list[str], where: str, quantity: str) -> None:
        found = _MEASURE.fullmatch(text)
        if found is None or found[1] not in REDUCTIONS:
            valid = ", ".join(f"{one}(...)" for one in REDUCTIONS)
            raise Refusal(where, quantity, "be a measure", repr(text), valid)
        self.kind = found[1]
        whole = parse_expression(found[2], where, quantity)
        self.of: list[Expression] = meant_by(whole, known, where, quantity)
        self.begin()

    def begin(self) -> None:
        """Begin a run."""
        self._found = [-math.inf if self.kind == "max" else math.inf] * len(self.of)
        self._sums, self._count = [0.0] * len(self.of), 0

    def take(self, signals: Signals, count: int) -> None:
        """Go on with some samples."""
        self._count += count
        for place, one in enumerate(self.of):
            values = np.broadcast_to(value_of(one, signals), (count,))
            match self.kind:
                case "max":
                    self._found[place] = max(self._found[place], float(values.max()))
                case "min":
                    self._found[place] = min(self._found[place], float(values.min()))
                case "last":
                    self._found[place] = float(values[-1])
                case "mean":
                    self._sums[place] += float(values.sum())
                case _:
                    self._sums[place] += float((values * values).sum())

    def end(self) -> float:
        """End the run and return its value."""
        found = self._found
        if self.kind in ("mean", "rms"):
            found = [one / self._count for one in self._sums]
        value = min(found) if self.kind == "min" else max(found)
        return math.sqrt(value) if self.kind == "rms" else value


class Checked:
    """A Python function that judges a whole trace and returns its robustness.

    Args:
        section: ``python: FILE:FUNCTION`` and ``signals``, the names that it gets.
        known: signals.
        folder: where the file is.

    Raises:
        Refusal: no such file or function, or signals that are not known.
    """

    def __init__(self, section: Section, known: list[str], folder: Path) -> None:
        self._where = section.where
        file, _, name = section.text("python").partition(":")
        wanted = [str(one) for one in section.entries("signals")]
        self.names: list[str] = []
        import fnmatch

        for pattern in wanted:
            found = fnmatch.filter(known, pattern)
            if not found:
                valid = ", ".join(known)
                raise section.refusal("signals", "name signals of the run", pattern, valid)
            self.names += found
        section.finish()
        if not name or not (folder / file).is_file():
            rule = "be FILE:FUNCTION, a file beside the campaign's"
            raise section.refusal("python", rule, section.text("python"))
        self._function = _function(folder / file, name, section)
        self._trace: list[Signals] = []

    def begin(self) -> None:
        """Begin a run."""
        self._trace = []

    def take(self, signals: Signals, count: int) -> None:
        """Keep some samples."""
        self._trace.append({name: signals[name] for name in (*self.names, "t")})

    def end(self) -> float:
        """Return the function's result."""
        names = self._trace[0]
        whole = {name: np.concatenate([one[name] for one in self._trace]) for name in names}
        return float(self._function(whole))


def _function(file: Path, name: str, section: Section) -> Callable[[Signals], Any]:
    spec = importlib.util.spec_from_file_location(f"campaign_{file.stem}", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        got = f"{type(error).__name__}: {error}"
        raise section.refusal("python", "be a file that Python can run", got) from None
    function = getattr(module, name, None)
    if not callable(function):
        valid = ", ".join(key for key, one in vars(module).items() if callable(one))
        raise section.refusal("python", "name a function of the file", name, valid or "none")
    return function  # type: ignore[no-any-return]


class _Formula:
    """A requirement as text."""

    def __init__(self, text: str, campaign: Campaign, known: list[str], quantity: str) -> None:
        where, period = campaign.where, campaign.scene.servo_period
        longest = 1 + max(1, ticks_of(campaign.nominal[0].seconds, period))
        if campaign.draws_sections:
            longest = 2**40
        formula = bound_to(parse_formula(text, where, quantity), known, where, quantity)
        self.names = signals_in(formula)
        self._one = Robustness(formula, period, longest, where, quantity)
        self.take, self.end = self._one.feed, self._one.end

    def begin(self) -> None:
        self._one.end()


class Judges:
    """All judges of a run.

    Attributes:
        signals: that it needs.

    Args:
        campaign: that states it.

    Raises:
        Refusal: a requirement or measure that is not taken.
    """

    def __init__(self, campaign: Campaign) -> None:
        known = list(units_of_signals(campaign.scene))
        root = Section({"requirements": dict(campaign.requirements)}, campaign.where)
        section = root.required_section("requirements")
        self._requirements: dict[str, _Formula | Checked] = {}
        for name, given in campaign.requirements.items():
            self._requirements[name] = (
                _Formula(given, campaign, known, f"requirements.{name}")
                if isinstance(given, str)
                else Checked(section.required_section(name), known, campaign.file.parent)
            )
        self._measures = {
            name: Measure(text, known, campaign.where, f"measures.{name}")
            for name, text in campaign.measures.items()
        }
        names: set[str] = set()
        for requirement in self._requirements.values():
            names |= set(requirement.names)
        for measure in self._measures.values():
            names = names.union(*map(signals_in, measure.of))
        self.signals = names

    def begin(self) -> None:
        """Begin a run."""
        for one in (*self._requirements.values(), *self._measures.values()):
            one.begin()

    def take(self, signals: Signals, count: int) -> None:
        """Go on with some samples."""
        for one in (*self._requirements.values(), *self._measures.values()):
            one.take(signals, count)

    def end(self, diverged: bool) -> tuple[dict[str, float], dict[str, float]]:
        """End the run; return robustness and measures."""
        if diverged:
            return dict.fromkeys(self._requirements, -math.inf), dict.fromkeys(
                self._measures, math.nan
            )
        robustness = {name: one.end() for name, one in self._requirements.items()}
        return robustness, {name: one.end() for name, one in self._measures.items()}
