"""Falsification: the margin of a requirement minimised, until a run fails."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from arm_emulator.base.number import number
from arm_emulator.base.section import Section
from arm_emulator.campaign.search.method import Course, Finding, Method
from arm_emulator.campaign.variation import Variation
from arm_emulator.machine.chain import Array

WORST = -1e9  # margin of a run that diverged


@dataclass(frozen=True, kw_only=True)
class CmaEs(Method):
    """Evolution of a normal distribution (CMA-ES), with restarts; package cma."""

    kind: ClassVar[str] = "cma-es"
    package: ClassVar[tuple[str, ...]] = ("cma", "cma")

    most: float = number(ends=(1, 10**7), whole=True, default=1000, text="runs at most")
    within: float = number(
        "standard deviations", above=0.0, at_most=8.0, default=3.0,
        text="of each number, in the scale of its normal scores: how far from its median it looks"
    )  # fmt: skip
    below: float = number(
        default=0.0, ends=(-1e300, 1e300), text="margin below which it is content and ends"
    )

    def runs(self, D: int) -> int:
        """Return how many runs it takes at most."""
        return int(self.most)

    def check(self, section: Section, variation: Variation) -> None:
        """Refuse fewer than two numbers.

        Raises:
            Refusal: see above.
        """
        if len(variation.numbers) < 2:
            rule = "have at least two numbers that vary"
            raise section.refusal("method", rule, len(variation.numbers))

    def course(self, D: int, of: str, seed: int) -> Course:
        """Return its course."""
        from cma import CMAEvolutionStrategy

        least, rng = _Least(), np.random.default_rng(seed)
        size, begin = 4 + int(3.0 * np.log(D)), np.zeros(D)
        while not self._ends(least):
            evolution = CMAEvolutionStrategy(begin, 0.3 * self.within, {
                "bounds": [-self.within, self.within], "popsize": size, "verbose": -9,
                "seed": int(rng.integers(1, 2**31)), "verb_disp": 0, "verb_log": 0,
            })  # fmt: skip
            while not (self._ends(least) or evolution.stop()):
                points = np.array(evolution.ask())
                margins = yield points[: int(self.most) - least.runs]
                least.take(margins)
                if len(margins) == len(points):
                    known = np.maximum(np.nan_to_num(margins, nan=WORST), WORST)
                    evolution.tell(list(points), known.tolist())
            size, begin = 2 * size, rng.uniform(-self.within, self.within, D)
        return least.finding(self.kind, of)

    def _ends(self, least: _Least) -> bool:
        return least.runs >= self.most or least.margin < self.below


class _Least:
    """The least margin so far."""

    def __init__(self) -> None:
        self.runs, self.failed, self.run, self.margin = 0, 0, -1, np.inf

    def take(self, margins: Array) -> None:
        at = int(np.argmin(margins))
        if margins[at] < self.margin or np.isnan(margins[at]):
            self.run, self.margin = self.runs + at, float(margins[at])
        self.failed += int(np.count_nonzero(~(margins >= 0.0)))
        self.runs += len(margins)

    def finding(self, kind: str, of: str) -> Finding:
        found = f"{self.failed} of {self.runs} runs fail" if self.failed else "no run fails"
        return Finding(
            "Falsification",
            f"{kind} minimised the margin of {of}: {found}.",
            ("requirement", "least margin", "in run", "runs", "failing runs"),
            ((of, self.margin, self.run, self.runs, self.failed),),
        )
