"""Base of methods that reach rare failures level by level, several times, for an interval."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import number
from arm_emulator_campaign.sampling.intervals import bound_mean
from arm_emulator_campaign.search.method import Finding, Method


def choose_places(count: int, of: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return `count` places of a list of `of` entries, each as often as others but for chance."""
    order: NDArray[np.int64] = rng.permutation(of)
    places: NDArray[np.int64] = order[((np.arange(count) + rng.random()) * of / count).astype(int)]
    return places


@dataclass(frozen=True, kw_only=True)
class ByLevels(Method):
    """A method that multiplies the shares of runs that reach each next level."""

    max_levels: ClassVar[int]

    repetitions: float = number(
        ends=(4, 1000), whole=True, default=10, text="independent ones, for the interval"
    )
    confidence: float = number(above=0.5, at_most=0.999999, default=0.95, text="of the interval")
    least: float = number(
        above=0.0, at_most=0.1, default=1e-12, text="probability below which it gives up"
    )
    per_level: float = 0.0  # runs; each method declares its own
    share: float = 0.0  # of a level's runs from which the next begins

    @property
    def _levels(self) -> int:
        """Levels after which a repetition gives up."""
        return min(self.max_levels, math.ceil(math.log(self.least) / math.log(self.share)))

    def _make_finding(
        self, of: str, p: Sequence[float], runs: int, about: str, nothing: str
    ) -> Finding:
        """Return the probability of a failure by that of each repetition.

        Args:
            of: the requirement.
            p: of the repetitions; none: no level led to a failure.
            runs: of all.
            about: how it was found.
            nothing: what replaces that if no level led to a failure.
        """
        mean, (low, high), words = 0.0, (0.0, 1.0), nothing
        if len(p):
            mean, (low, high), words = (
                float(np.mean(p)),
                bound_mean(np.asarray(p), self.confidence),
                about,
            )
            if lost := int(np.count_nonzero(np.equal(p, 0.0))):
                words += f" {lost} found no failure: take more runs per level."
        percent = f"{100 * self.confidence:g} %"
        head = "requirement", "probability", f"low end ({percent})", f"high end ({percent})", "runs"
        return Finding("Rare failures", words, head, ((of, mean, low, high, runs),))
