"""Rare failures by subset simulation: levels of the margin, each reached from the one before.

A level is begun from the points of the one before that are below it, by Markov chains that stay
there: a candidate of a state z is r z + sqrt(1 - r^2) x with a new normal x, which leaves the
normal distribution as it is (conditional sampling; Papaioannou and others, Probabilistic
Engineering Mechanics 41, 2015). The probability is the product of the shares that reach the next
level (Au and Beck, same journal 16, 2001).

A pilot sets the levels, and r of each. Independent repetitions with these follow side by side.
Levels and chains that do not adapt make the mean of each the true probability, however few its
points (levels of its own would make it too large: 1.24 times for 1e-6 from 300 points a level),
and how far repetitions differ gives the interval: nothing about the chains needs to be assumed.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from arm_emulator.base.number import number
from arm_emulator.base.section import Section
from arm_emulator.campaign.intervals import of_repetitions
from arm_emulator.campaign.search.method import Course, Finding, Method
from arm_emulator.campaign.variation import Variation
from arm_emulator.machine.chain import Array

MOST_LEVELS = 40
ACCEPTED = 0.44  # share of candidates at which chains forget soonest


@dataclass(frozen=True, kw_only=True)
class Subset(Method):
    """Subset simulation: probabilities of failures too rare to be sampled, with their interval."""

    kind: ClassVar[str] = "subset"

    repetitions: float = number(
        ends=(4, 1000), whole=True, default=10, text="independent ones, for the interval"
    )
    confidence: float = number(above=0.5, at_most=0.999999, default=0.95, text="of the interval")
    least: float = number(
        above=0.0, at_most=0.1, default=1e-12, text="probability below which it gives up"
    )
    per_level: float = number(
        ends=(20, 10**7), whole=True, default=1000, text="runs of a level, a repetition"
    )
    share: float = number(
        ends=(0.01, 0.5), default=0.1, text="of a level's runs from which the next begins"
    )

    def check(self, section: Section, variation: Variation) -> None:
        """Refuse levels without chains.

        Raises:
            Refusal: see above.
        """
        super().check(section, variation)
        if self.share * self.per_level < 2.0:
            rule = f"leave two chains a level, {2.0 / self.share:g} runs"
            raise section.refusal("per_level", rule, int(self.per_level))

    def runs(self, D: int) -> int:
        """Return how many runs it takes at most."""
        return int((self.repetitions + 2) * self.per_level) * (self._levels + 1)

    @property
    def _levels(self) -> int:
        """Levels after which a repetition gives up."""
        return min(MOST_LEVELS, math.ceil(math.log(self.least) / math.log(self.share)))

    def course(self, D: int, of: str, seed: int) -> Course:
        """Return its course."""
        rng, N = np.random.default_rng(seed), int(self.per_level)
        chains = round(self.share * N)
        levels, found, runs = yield from self._pilot(rng, D, N, chains)
        if not found:
            return self._finding(of, np.zeros(0), runs)
        K = int(self.repetitions)
        z = rng.standard_normal((K, N, D))
        margins = (yield z.reshape(-1, D)).reshape(K, N)
        p, runs = np.ones(K), runs + K * N
        for level, scale in levels:
            below = margins <= level
            p *= np.mean(below, axis=1)
            going = np.flatnonzero(p > 0.0)
            if not len(going):
                break
            starts = [_chosen(np.flatnonzero(below[k]), chains, rng) for k in going]
            now = np.array([z[k][at] for k, at in zip(going, starts, strict=True)])
            of_now = np.array([margins[k][at] for k, at in zip(going, starts, strict=True)])
            z[going], margins[going], _ = yield from _chains(now, of_now, level, scale, N, rng)
            runs += len(going) * (N - chains)
        p *= np.mean(margins < 0.0, axis=1)
        return self._finding(of, p, runs)

    def _pilot(
        self, rng: np.random.Generator, D: int, N: int, chains: int
    ) -> Generator[Array, Array, tuple[list[tuple[float, float]], bool, int]]:
        """Return levels with scales of their chains, whether they reach failures, and the runs."""
        z = rng.standard_normal((1, N, D))
        margins = (yield z[0])[None]
        levels, scale, runs = list[tuple[float, float]](), 0.6, N
        while np.count_nonzero(margins < 0.0) < chains:
            order = np.argsort(margins[0], kind="stable")[:chains]
            level = float(margins[0, order[-1]])
            if len(levels) == self._levels or level == np.max(margins):  # too rare, or a plateau
                return levels, False, runs
            for _ in range(2):  # a level that is tried with the scale of the one before, and anew
                found = yield from _chains(z[:, order], margins[:, order], level, scale, N, rng)
                runs += N - chains
                if abs(found[2] - ACCEPTED) < 0.15:
                    break
                scale = min(1.0, scale * math.exp(2.0 * (found[2] - ACCEPTED)))
            levels.append((level, scale))
            z, margins, _ = found
        return levels, True, runs

    def _finding(self, of: str, p: Array, runs: int) -> Finding:
        """Return the probability of a failure by that of each repetition.

        Args:
            of: the requirement.
            p: of the repetitions; none: no level led to a failure.
            runs: of all.
        """
        mean, (low, high) = 0.0, (0.0, 1.0)
        about = f"No level reached a failure of {of}: rarer than `least`, or impossible."
        if len(p):
            mean, (low, high) = float(np.mean(p)), of_repetitions(p, self.confidence)
            about = f"Margin of {of} below 0: mean of {len(p)} repetitions, {runs} runs in all."
            if lost := int(np.count_nonzero(p == 0.0)):
                about += f" {lost} found no failure: take more runs per level."
        percent = f"{100 * self.confidence:g} %"
        head = "requirement", "probability", f"low end ({percent})", f"high end ({percent})", "runs"
        return Finding("Rare failures", about, head, ((of, mean, low, high, runs),))


def _chosen(places: NDArray[np.int64], count: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return so many of the places, each as often as the others but for chance."""
    order = rng.permutation(places)
    some: NDArray[np.int64] = order[
        ((np.arange(count) + rng.random()) * len(order) / count).astype(int)
    ]
    return some


def _chains(
    now: Array, of_now: Array, level: float, scale: float, N: int, rng: np.random.Generator
) -> Generator[Array, Array, tuple[Array, Array, float]]:
    """Run chains below a level from states (K, n, D) with their margins (K, n).

    Returns:
        N states of each repetition (K, N, D), their margins, and the share of candidates taken.
    """
    K, n, D = now.shape
    states, margins, taken = [now], [of_now], list[float]()
    for _ in range(-(-N // n) - 1):
        x = rng.standard_normal(now.shape)
        candidates = math.sqrt(1.0 - scale * scale) * now + scale * x
        found = (yield candidates.reshape(-1, D)).reshape(K, n)
        below = found <= level
        now = np.where(below[:, :, None], candidates, now)
        of_now = np.where(below, found, of_now)
        states.append(now)
        margins.append(of_now)
        taken.append(float(np.mean(below)))
    return (
        np.concatenate(states, axis=1)[:, :N],
        np.concatenate(margins, axis=1)[:, :N],
        float(np.mean(taken)),
    )
