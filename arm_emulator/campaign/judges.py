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

from arm_emulator.base.bound_formula import bound_to, meant_by
from arm_emulator.base.formula import (
    Expression,
    Formula,
    Signal,
    parse_expression,
    parse_formula,
)
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.section import Section
from arm_emulator.campaign.campaign_file import Campaign
from arm_emulator.campaign.program import Program, Rows, Targets, judges
from arm_emulator.campaign.requirement import Robustness
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

    def end(self, values: list[float]) -> float:
        """Return the measure of several signals from that of each."""
        return min(values) if self.kind == "min" else max(values)


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
        self.names.append("t")
        section.finish()
        if not name or not (folder / file).is_file():
            rule = "be FILE:FUNCTION, a file beside the campaign's"
            raise section.refusal("python", rule, section.text("python"))
        self._function = _function(folder / file, name, section)
        self._trace: list[Array] = []

    def begin(self) -> None:
        """Begin a run."""
        self._trace = []

    def take(self, rows: Array) -> None:
        """Keep some samples (K, n) of the names."""
        self._trace.append(rows.copy())

    def end(self) -> float:
        """Return the function's result."""
        whole = np.concatenate(self._trace, axis=1)
        return float(self._function(dict(zip(self.names, whole, strict=True))))


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


class Judges:
    """All judges of a run.

    Attributes:
        samples: signals that it needs, in the order of their rows.

    Args:
        campaign: that states it.
        room: samples in a piece at most.

    Raises:
        Refusal: a requirement or measure that is not taken.
    """

    def __init__(self, campaign: Campaign, room: int) -> None:
        scene, where = campaign.scene, campaign.where
        known = list(units_of_signals(scene))
        rows = Rows(scene.joint_names, scene.servo_period)
        section = Section({"requirements": dict(campaign.requirements)}, where)
        given = section.required_section("requirements")
        formulas: dict[str, Formula] = {}
        self._checked: dict[str, Checked] = {}
        for name, text in campaign.requirements.items():
            if isinstance(text, str):
                quantity = f"requirements.{name}"
                formula = parse_formula(text, where, quantity)
                formulas[name] = bound_to(formula, known, where, quantity)
            else:
                below = given.required_section(name)
                self._checked[name] = Checked(below, known, campaign.file.parent)
        self._measures = {
            name: Measure(text, known, where, f"measures.{name}")
            for name, text in campaign.measures.items()
        }
        self._names = list(campaign.requirements)
        self._formulas = list(formulas)
        longest = 1 + max(1, ticks_of(campaign.nominal[0].seconds, scene.servo_period))
        if campaign.draws_sections:
            longest = 2**40
        requirements = [
            Robustness(
                judges(), one, rows.of, scene.servo_period, longest, where, f"requirements.{name}"
            )
            for name, one in formulas.items()
        ]
        kept = [rows.of(Signal(name)) for one in self._checked.values() for name in one.names]
        reduced = [(one.kind, rows.of(each)) for one in self._measures.values() for each in one.of]
        self._program = Program(rows, requirements, reduced, kept, room)
        self.samples = rows.samples

    def begin(self) -> None:
        """Begin a run."""
        self._program.begin()
        for one in self._checked.values():
            one.begin()

    def take(self, samples: Array, count: int, targets: Targets) -> None:
        """Go on with some samples."""
        self._program.take(samples, count, targets)
        first = 0
        for one in self._checked.values():
            end = first + len(one.names)
            one.take(self._program.kept[first:end, :count])
            first = end

    def end(self, diverged: bool) -> tuple[dict[str, float], dict[str, float]]:
        """End the run; return robustness and measures."""
        if diverged:
            return dict.fromkeys(self._names, -math.inf), dict.fromkeys(self._measures, math.nan)
        values, reduced = self._program.end()
        found = dict(zip(self._formulas, values, strict=True))
        found |= {name: one.end() for name, one in self._checked.items()}
        rest = iter(reduced)
        measures = {
            name: one.end([next(rest) for _ in one.of]) for name, one in self._measures.items()
        }
        return {name: found[name] for name in self._names}, measures
