"""Falsification: the margin of a requirement minimised, until a run fails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from arm_emulator.extension.base import Array, Section, number
from arm_emulator_campaign.sampling.variation import Variation
from arm_emulator_campaign.search.method import Finding, Method, Sampler

WORST = -1e9  # margin of a run that diverged


@dataclass(frozen=True, kw_only=True)
class Falsification(Method):
    """Base of both."""

    most: float = number(ends=(1, 10**7), whole=True, default=1000, text="runs at most")
    within: float = number(
        "standard deviations", above=0.0, at_most=8.0, default=3.0,
        text="of each number, in the scale of its normal scores: how far from its median it looks"
    )  # fmt: skip
    below: float = number(
        default=0.0, ends=(-1e300, 1e300), text="margin below which it is content and ends"
    )

    def count_runs(self, D: int) -> int:
        """Return how many runs it takes at most."""
        return int(self.most)

    def _ask_margins(self, minimum: _LowestMargin, points: Array) -> Any:
        """Yield points to run, as many as are left; return their margins."""
        points = points[: self.count_runs(0) - minimum.runs]
        margins = (yield points)[:, 0]
        minimum.take_margins(margins)
        return np.maximum(np.nan_to_num(margins, nan=WORST), WORST)

    def _is_over(self, minimum: _LowestMargin) -> bool:
        return minimum.runs >= self.most or minimum.margin < self.below


class _LowestMargin:
    """The least margin so far."""

    def __init__(self) -> None:
        self.runs, self.failed, self.run, self.margin = 0, 0, -1, np.inf

    def take_margins(self, margins: Array) -> None:
        at = int(np.argmin(margins))
        if margins[at] < self.margin or np.isnan(margins[at]):
            self.run, self.margin = self.runs + at, float(margins[at])
        self.failed += int(np.count_nonzero(~(margins >= 0.0)))
        self.runs += len(margins)

    def make_finding(self, kind: str, of: str) -> Finding:
        failures = f"{self.failed} of {self.runs} runs fail" if self.failed else "no run fails"
        return Finding(
            "Falsification",
            f"{kind} minimised the margin of {of}: {failures}.",
            ("requirement", "least margin", "in run", "runs", "failing runs"),
            ((of, self.margin, self.run, self.runs, self.failed),),
        )


@dataclass(frozen=True, kw_only=True)
class CmaEs(Falsification):
    """Evolution of a normal distribution (CMA-ES), with restarts; package cma."""

    kind: ClassVar[str] = "cma-es"
    package: ClassVar[tuple[str, ...]] = ("cma", "cma")

    def check_campaign(self, section: Section, variation: Variation) -> None:
        """Refuse fewer than two numbers."""
        if len(variation.numbers) < 2:
            rule = "have at least two numbers that vary"
            raise section.make_refusal("method", rule, len(variation.numbers), "bayes")

    def make_sampler(self, names: Sequence[str], outputs: Sequence[str], seed: int) -> Sampler:
        """Return its course."""
        from cma import CMAEvolutionStrategy

        minimum, rng, D = _LowestMargin(), np.random.default_rng(seed), len(names)
        size, begin = 4 + int(3.0 * np.log(D)), np.zeros(D)
        while not self._is_over(minimum):
            evolution = CMAEvolutionStrategy(begin, 0.3 * self.within, {
                "bounds": [-self.within, self.within], "popsize": size, "verbose": -9,
                "seed": int(rng.integers(1, 2**31)), "verb_disp": 0, "verb_log": 0,
            })  # fmt: skip
            while not (self._is_over(minimum) or evolution.stop()):
                points = np.array(evolution.ask())
                margins = yield from self._ask_margins(minimum, points)
                if len(margins) == len(points):
                    evolution.tell(list(points), margins.tolist())
            size, begin = 2 * size, rng.uniform(-self.within, self.within, D)
        return [minimum.make_finding(self.kind, outputs[0])]


@dataclass(frozen=True, kw_only=True)
class Bayes(Falsification):
    """Bayesian sampler (tree of Parzen estimators), for few and expensive runs; package optuna."""

    kind: ClassVar[str] = "bayes"
    package: ClassVar[tuple[str, ...]] = ("optuna", "optuna")

    at_once: float = number(
        ends=(1, 10_000), whole=True, default=8,
        text="runs between two looks at their margins; they can be simulated side by side"
    )  # fmt: skip

    def make_sampler(self, names: Sequence[str], outputs: Sequence[str], seed: int) -> Sampler:
        """Return its course."""
        import optuna

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        sampler = optuna.samplers.TPESampler(
            seed=seed % 2**32, constant_liar=True, multivariate=True
        )
        study = optuna.create_study(sampler=sampler)
        each = optuna.distributions.FloatDistribution(-self.within, self.within)
        minimum = _LowestMargin()
        while not self._is_over(minimum):
            trials = [study.ask(dict.fromkeys(names, each)) for _ in range(int(self.at_once))]
            points = np.array([[proposal.params[name] for name in names] for proposal in trials])
            margins = yield from self._ask_margins(minimum, points)
            for trial, margin in zip(trials, margins.tolist(), strict=False):
                study.tell(trial, margin)
        return [minimum.make_finding(self.kind, outputs[0])]
