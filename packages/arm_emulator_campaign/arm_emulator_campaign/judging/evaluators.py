"""Judges of a run: requirements, measures, and functions of Python over the whole trace."""

from __future__ import annotations

import importlib.util
import math
import re
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import (
    Array,
    Combined,
    Expression,
    Formula,
    Refusal,
    Section,
    Signal,
    bind_signals,
    coerce_array,
    expand_stars,
    parse_expression,
    parse_formula,
)
from arm_emulator.extension.machine import is_at_one_instant
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.definition.scenario import count_ticks
from arm_emulator_campaign.judging.program import Program, Rows, Targets, judges
from arm_emulator_campaign.judging.requirement import Robustness
from arm_emulator_campaign.judging.signals import has_tool_signals, list_signal_units
from arm_emulator_campaign.judging.vibration_requirement import KEY, VibrationRequirement

Signals = Mapping[str, Array]
REDUCTIONS = ("max", "min", "mean", "rms", "last")
_MEASURE = re.compile(r"\s*(\w+)\s*\((.*)\)\s*", re.DOTALL)


class Measure:
    """A number of a run: the maximum, minimum, mean, root mean square or last value of arithmetic.

    Args:
        text: such as ``max(abs(measured.current.elbow))``; a ``*`` takes the largest, or for
            ``min`` the smallest, of all that it means.
        signal_names: signals.
        where: for refusals.
        quantity: for refusals.

    Raises:
        Refusal: an unknown form.
    """

    def __init__(self, text: str, signal_names: list[str], where: str, quantity: str) -> None:
        match = _MEASURE.fullmatch(text)
        if match is None or match[1] not in REDUCTIONS:
            valid = ", ".join(f"{reduction}(...)" for reduction in REDUCTIONS)
            raise Refusal(where, quantity, "be a measure", repr(text), valid)
        self.kind = match[1]
        expression = parse_expression(match[2], where, quantity)
        self.of: list[Expression] = expand_stars(expression, signal_names, where, quantity)

    def combine_signals(self, values: Array) -> Array:
        """Return the measure of several signals (runs,) from that of each (runs, signals)."""
        of_all: Array = values.min(axis=1) if self.kind == "min" else values.max(axis=1)
        return of_all


class PythonRequirement:
    """A Python function that judges a whole trace and returns its robustness.

    Args:
        section: ``python: FILE:FUNCTION`` and ``signals``, the names that it gets.
        signal_names: signals.
        folder: the campaign's. The file is code, so that it must be in this folder or below it,
            links followed.

    Raises:
        Refusal: no such file or function there, or signals that are not known.
    """

    def __init__(self, section: Section, signal_names: list[str], folder: Path) -> None:
        file, _, name = section.read_text("python").partition(":")
        patterns = [str(entry) for entry in section.read_entries("signals")]
        self.names: list[str] = []
        import fnmatch

        for pattern in patterns:
            names = fnmatch.filter(signal_names, pattern)
            if not names:
                valid = ", ".join(signal_names)
                raise section.make_refusal("signals", "name signals of the run", pattern, valid)
            self.names += names
        self.names.append("t")
        section.refuse_unread_keys()
        code = (folder / file).resolve()
        if not name or not code.is_file() or not code.is_relative_to(folder.resolve()):
            rule = "be FILE:FUNCTION, a file beside the campaign's or below its folder"
            raise section.make_refusal("python", rule, section.read_text("python"))
        self._function, self._section = _load_function(code, name, section), section

    def judge_trace(self, trace: Sequence[Array]) -> float:
        """Return the function's result for pieces (names, n) of a run.

        Raises:
            Refusal: the function raises something, or returns no number.
        """
        signals = np.concatenate(trace, axis=1)
        try:
            margin = self._function(dict(zip(self.names, signals, strict=True)))
        except (Exception, SystemExit) as error:
            line = traceback.extract_tb(error.__traceback__)[-1]
            value = f"{type(error).__name__}: {error} ({Path(line.filename).name}:{line.lineno})"
            raise self._section.make_refusal("python", "return a margin", value) from None
        number = coerce_array(margin)
        if number is None or number.ndim:
            raise self._section.make_refusal("python", "return a margin, one number", margin)
        return float(number)


def _load_function(file: Path, name: str, section: Section) -> Callable[[Signals], Any]:
    spec = importlib.util.spec_from_file_location(f"campaign_{file.stem}", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        value = f"{type(error).__name__}: {error}"
        raise section.make_refusal("python", "be a file that Python can run", value) from None
    function = getattr(module, name, None)
    if not callable(function):
        valid = ", ".join(key for key, value in vars(module).items() if callable(value))
        raise section.make_refusal("python", "name a function of the file", name, valid or "none")
    return function  # type: ignore[no-any-return]


def find_start_requirements(campaign: Campaign) -> Iterator[str]:
    """Yield a line for each requirement that judges only the first sample of a run, in all or part.

    It is a part that the whole needs: of an `implies` or `or` it may be meant so.
    """
    for name, text in campaign.requirements.items():
        if not isinstance(text, str):
            continue
        formula = parse_formula(text, campaign.where, f"requirements.{name}")
        parts: tuple[Formula, ...] = (formula,)
        if isinstance(formula, Combined) and formula.sign == "and":
            parts = formula.of
        at_start = [is_at_one_instant(part) for part in parts]
        if all(at_start):
            valid = f"always ({text}) judges the whole run, always[0, 0] ({text}) its start"
            yield f"{campaign.where}: requirements.{name} judges the first sample alone; {valid}"
        elif any(at_start):
            rule = "a part without always, eventually or until judges the first sample alone"
            yield f"{campaign.where}: requirements.{name}: {rule}; always (...) the whole run"


def count_most_samples(campaign: Campaign) -> int | None:
    """Return how many samples a run has at most; None: it may last as long as it was drawn."""
    if any(number.name == "scenario.seconds" for number in campaign.variation.numbers):
        return None
    ticks = count_ticks(campaign.nominal[0].seconds, campaign.scene.servo_period)
    return 1 + max(1, ticks)


class Evaluators:
    """All judges of runs.

    Attributes:
        samples: signals that they need, in the order of their rows.
        program: judges the formulas and reduces the measures.
        needs_processor: whether some judge, or a sample, is computed by the processor alone.

    Args:
        campaign: that states them.
        room: samples in a piece at most.
        runs: that are judged at the same time.
        make_program: makes their `Program`.
    """

    def __init__(
        self,
        campaign: Campaign,
        room: int,
        runs: int = 1,
        make_program: Callable[..., Program] = Program,
    ) -> None:
        scene, where = campaign.scene, campaign.where
        signal_names = list(list_signal_units(scene))
        rows = Rows(scene.joint_names, scene.integrator.dt, scene.steps_per_period)
        section = Section({"requirements": dict(campaign.requirements)}, where)
        requirement_section = section.require_section("requirements")
        formulas: dict[str, Formula] = {}
        self._checked: dict[str, PythonRequirement | VibrationRequirement] = {}
        for name, text in campaign.requirements.items():
            if isinstance(text, str):
                quantity = f"requirements.{name}"
                formula = parse_formula(text, where, quantity)
                formulas[name] = bind_signals(formula, signal_names, where, quantity)
            else:
                below = requirement_section.require_section(name)
                self._checked[name] = (
                    VibrationRequirement(below, scene)
                    if KEY in text
                    else PythonRequirement(below, signal_names, campaign.file.parent)
                )
        self._measures = [
            Measure(text, signal_names, where, f"measures.{name}")
            for name, text in campaign.measures.items()
        ]
        names = list(campaign.requirements)
        self._of_formulas = [names.index(name) for name in formulas]
        self._of_checked = [names.index(name) for name in self._checked]
        longest = count_most_samples(campaign)
        period = scene.servo_period
        requirements = [
            [
                Robustness(
                    judges(),
                    requirement,
                    rows.add_formula,
                    period,
                    2**40 if longest is None else longest,
                    where,
                    f"requirements.{name}",
                )
                for name, requirement in formulas.items()
            ]
            for _ in range(runs)
        ]
        traced_rows = [
            rows.add_expression(Signal(name))
            for value in self._checked.values()
            for name in value.names
        ]
        reduced = [
            (measure.kind, rows.add_expression(each))
            for measure in self._measures
            for each in measure.of
        ]
        self.program = make_program(rows, requirements, reduced, traced_rows, room)
        self._traces: list[list[Array]] = [[] for _ in range(runs)]  # of those that need all of it
        self.samples = rows.samples
        self.needs_processor = bool(self._checked or has_tool_signals(self.samples))

    def begin_runs(self) -> None:
        """Begin all runs."""
        self.program.begin_runs()
        for trace in self._traces if self._checked else ():
            trace.clear()

    def take_samples(self, samples: Any, counts: NDArray[np.int64], targets: Targets) -> None:
        """Go on with samples (runs, S, room), of which there are so many (runs,), see `Program`."""
        self.program.take_samples(samples, counts, targets)
        if self._checked:
            for trace, rows, count in zip(self._traces, self.program.kept, counts, strict=False):
                trace.append(rows[:, :count].copy())

    def end_runs(self, diverged: NDArray[np.bool_]) -> tuple[Array, Array]:
        """End the runs (runs,); return robustness and measures, a row for each.

        They are -inf and NaN in runs that diverged; robustness that is not a number is -inf, too.
        """
        values, reduced = self.program.end_runs()
        runs = len(diverged)
        robustness = np.full((runs, len(self._of_formulas) + len(self._of_checked)), -math.inf)
        measures = np.full((runs, len(self._measures)), math.nan)
        sound = np.flatnonzero(~diverged)
        robustness[sound[:, None], self._of_formulas] = values[sound]
        for run in sound if self._checked else ():
            first = 0
            for place, checked in zip(self._of_checked, self._checked.values(), strict=True):
                end = first + len(checked.names)
                trace = [rows[first:end] for rows in self._traces[run]]
                robustness[run, place], first = checked.judge_trace(trace), end
        robustness[np.isnan(robustness)] = -math.inf
        first = 0
        for place, measure in enumerate(self._measures):
            end = first + len(measure.of)
            measures[sound, place] = measure.combine_signals(reduced[sound, first:end])
            first = end
        return robustness, measures
