"""Rare failures by subset simulation: levels of the margin, each reached from the one before.

A level begins from the points of the previous level that are below it, by Markov chains that stay
below it. A candidate of a state z is r z + sqrt(1 - r^2) x with a new normal x. This step preserves
the normal distribution (conditional sampling; Papaioannou and others, Probabilistic Engineering
Mechanics 41, 2015). The probability is the product of the shares that reach the next
level (Au and Beck, same journal 16, 2001).

A pilot sets the levels, and r of each. Independent repetitions with these follow side by side.
Since levels and chains do not adapt, the mean of each repetition is the true probability, however
few its points. (Levels of its own would make it too large: 1.24 times for 1e-6 from 300 points a
level.) The differences between repetitions give the interval: it needs no assumption about the
chains.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from arm_emulator.extension.base import Array, Section, number
from arm_emulator_campaign.sampling.variation import Variation
from arm_emulator_campaign.search.by_levels import ByLevels, choose_places
from arm_emulator_campaign.search.method import Finding, Sampler

ACCEPTED = 0.44  # share of candidates at which chains forget soonest


@dataclass(frozen=True, kw_only=True)
class Subset(ByLevels):
    """Subset simulation: probabilities of failures too rare to be sampled, with their interval."""

    kind: ClassVar[str] = "subset"
    max_levels = 40

    per_level: float = number(
        ends=(20, 10**7), whole=True, default=1000, text="runs of a level, a repetition"
    )
    share: float = number(
        ends=(0.01, 0.5), default=0.1, text="of a level's runs from which the next begins"
    )

    def check_campaign(self, section: Section, variation: Variation) -> None:
        """Refuse levels without chains."""
        super().check_campaign(section, variation)
        if self.share * self.per_level < 2.0:
            rule = f"leave two chains a level, {2.0 / self.share:g} runs"
            raise section.make_refusal("per_level", rule, int(self.per_level))

    def count_runs(self, D: int) -> int:
        """Return how many runs it takes at most."""
        return int((self.repetitions + 2) * self.per_level) * (self._levels + 1)

    def make_sampler(self, names: Sequence[str], outputs: Sequence[str], seed: int) -> Sampler:
        """Return its course."""
        rng, D, N = np.random.default_rng(seed), len(names), int(self.per_level)
        chains = round(self.share * N)
        levels, survivors, runs = yield from self._run_pilot(rng, D, N, chains)
        if not survivors:
            return [self._list_findings(outputs[0], np.zeros(0), runs)]
        K = int(self.repetitions)
        z = rng.standard_normal((K, N, D))
        margins = (yield z.reshape(-1, D))[:, 0].reshape(K, N)
        p, runs = np.ones(K), runs + K * N
        for level, scale in levels:
            below = margins <= level
            p *= np.mean(below, axis=1)
            going = np.flatnonzero(p > 0.0)
            if not len(going):
                break
            reached = [np.flatnonzero(below[k]) for k in going]
            starts = [places[choose_places(chains, len(places), rng)] for places in reached]
            now = np.array([z[k][at] for k, at in zip(going, starts, strict=True)])
            of_now = np.array([margins[k][at] for k, at in zip(going, starts, strict=True)])
            z[going], margins[going], _ = yield from _run_chains(now, of_now, level, scale, N, rng)
            runs += len(going) * (N - chains)
        p *= np.mean(margins < 0.0, axis=1)
        return [self._list_findings(outputs[0], p, runs)]

    def _run_pilot(
        self, rng: np.random.Generator, D: int, N: int, chains: int
    ) -> Generator[Array, Array, tuple[list[tuple[float, float]], bool, int]]:
        """Return levels with scales of their chains, whether they reach failures, and the runs."""
        z = rng.standard_normal((1, N, D))
        margins = (yield z[0])[:, 0][None]
        levels, scale, runs = list[tuple[float, float]](), 0.6, N
        while np.count_nonzero(margins < 0.0) < chains:
            order = np.argsort(margins[0], kind="stable")[:chains]
            level = float(margins[0, order[-1]])
            if len(levels) == self._levels or level == np.max(margins):  # too rare, or a plateau
                return levels, False, runs
            for _ in range(2):  # a level that is tried with the scale of the one before, and anew
                outcome = yield from _run_chains(
                    z[:, order], margins[:, order], level, scale, N, rng
                )
                runs += N - chains
                if abs(outcome[2] - ACCEPTED) < 0.15:
                    break
                scale = min(1.0, scale * math.exp(2.0 * (outcome[2] - ACCEPTED)))
            levels.append((level, scale))
            z, margins, _ = outcome
        return levels, True, runs

    def _list_findings(self, of: str, p: Array, runs: int) -> Finding:
        about = f"Margin of {of} below 0: mean of {len(p)} repetitions, {runs} runs in all."
        nothing = f"No level reached a failure of {of}: rarer than `least`, or impossible."
        return self._make_finding(of, p.tolist(), runs, about, nothing)


def _run_chains(
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
        proposed = (yield candidates.reshape(-1, D))[:, 0].reshape(K, n)
        below = proposed <= level
        now = np.where(below[:, :, None], candidates, now)
        of_now = np.where(below, proposed, of_now)
        states.append(now)
        margins.append(of_now)
        taken.append(float(np.mean(below)))
    return (
        np.concatenate(states, axis=1)[:, :N],
        np.concatenate(margins, axis=1)[:, :N],
        float(np.mean(taken)),
    )
