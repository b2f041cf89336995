"""Rare failures by splitting: machines that are on the way to a failure are forked in mid-run.

A level is a margin. Of the runs that reach a level, some are chosen, and each continues from there
several times, with other noise: an exact copy of the machine with another seed. The probability is
the product of the shares of runs that reach the next level (Garvels and Kroese, Winter Simulation
Conference 1998: fixed effort). Unlike subset simulation it needs no numbers that vary: what the
sensors' noise causes during the run is enough.

A pilot sets the levels. Independent repetitions with these follow, each unbiased; how far they
differ gives the interval.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np

from arm_emulator.extension.base import Section, number
from arm_emulator_campaign.sampling.variation import Variation
from arm_emulator_campaign.search.by_levels import ByLevels, choose_places
from arm_emulator_campaign.search.method import Finding

SEEDS = 2**32

State = TypeVar("State")


class Process(Protocol[State]):
    """A random process whose margin never rises, and which can be forked."""

    @property
    def now(self) -> int:
        """The present tick."""

    def begin_run(self, index: int, seed: int) -> None:
        """Begin a run."""

    def go_on(self, state: State, seed: int) -> None:
        """Continue from a fork, with other random numbers."""

    def reach_level(self, level: float) -> tuple[bool, float]:
        """Advance until the margin is at most `level`, or to the end of the run.

        At level 0 the margin must be below it. Returns whether it is, and the margin.
        """

    def fork_run(self) -> State:
        """Return the present state."""


@dataclass(frozen=True)
class ForkOrigin:
    """From what a run follows.

    Attributes:
        index: of the run that was forked first.
        seeds: ticks from which on its noise is that of a seed, ascending from 0, and the seeds.
    """

    index: int
    seeds: Sequence[Sequence[int]]


@dataclass(frozen=True)
class SplittingRepetition:
    """An estimate of the probability, and the runs and parts of runs that it took.

    Attributes:
        probability: the product of the shares.
        runs: runs, and forks of runs.
        shares: of the runs at each level that reach the next, the failure last; it ends where none
            does.
        failures: the runs that failed.
    """

    probability: float
    runs: int
    shares: Sequence[float]
    failures: Sequence[ForkOrigin]


@dataclass(frozen=True, kw_only=True)
class Splitting(ByLevels):
    """Splitting: failures that noise causes during a run, by machines forked in mid-run."""

    kind: ClassVar[str] = "splitting"
    forks: ClassVar[bool] = True
    max_levels = 60

    per_level: float = number(
        ends=(20, 10**6), whole=True, default=200, text="runs of a level, a repetition"
    )
    share: float = number(
        ends=(0.01, 0.5), default=0.2, text="of a level's runs that reach the next"
    )
    look: float = number(
        "s", above=0.0, at_most=100.0, default=0.01, text="after which a run is looked at"
    )

    def check_campaign(self, section: Section, variation: Variation) -> None:
        """Refuse a search without one requirement; numbers need not vary, noise suffices."""
        if not self.of:
            raise section.make_refusal(
                "of", "name the requirement whose margin leads to it", "nothing"
            )

    def count_runs(self, D: int) -> int:
        """Return how many runs, or parts of runs, it takes at most."""
        return int((self.repetitions + 1) * self.per_level) * (self._levels + 1)

    def run_pilot(self, process: Process[Any], seed: int) -> tuple[list[float], bool]:
        """Return the levels, and whether they lead to failures."""
        rng, N = np.random.default_rng([seed, 0]), int(self.per_level)
        required, levels, starts = round(self.share * N), list[float](), list[Any]()
        while True:
            # The whole way of each run, to know how far it comes.
            seeds = _draw_seeds(rng, N)
            lowest = np.empty(N)
            for k in range(N):
                _set_run(process, starts, k, seeds)
                lowest[k] = process.reach_level(-math.inf)[1]
            if np.count_nonzero(lowest < 0.0) >= required:
                return levels, True
            level = max(0.0, float(np.sort(lowest)[required - 1]))
            before = levels[-1] if levels else math.inf
            if len(levels) == self._levels or not level < before:  # too rare, or a plateau
                return levels, False
            if level == 0.0:
                return levels, True
            levels.append(level)
            reached = []
            for k in range(N):  # the same runs once more, to the level
                if lowest[k] <= level:
                    origin = _set_run(process, starts, k, seeds)
                    process.reach_level(level)
                    reached.append((process.fork_run(), origin))
            starts = [reached[k] for k in choose_places(N, len(reached), rng)]

    def run_repetition(
        self, process: Process[Any], levels: Sequence[float], seed: int, number: int
    ) -> SplittingRepetition:
        """Return an estimate, a function of the seed and its number.

        Args:
            process: that fails.
            levels: of the margin, falling.
            seed: of the campaign.
            number: of the repetition, from 1 on.
        """
        rng, N = np.random.default_rng([seed, number]), int(self.per_level)
        first, shares, runs, starts = number * N, list[float](), 0, list[Any]()
        failures: list[ForkOrigin] = []
        for level in (*levels, 0.0):
            seeds, reached = _draw_seeds(rng, N), list[Any]()
            for k in range(N):
                origin = _set_run(process, starts, k, seeds, first)
                runs += 1
                if process.reach_level(level)[0]:
                    reached.append((None if level == 0.0 else process.fork_run(), origin))
            shares.append(len(reached) / N)
            if not reached:
                break
            if level == 0.0:
                failures = [origin for _, origin in reached]
            else:
                starts = [reached[k] for k in choose_places(N, len(reached), rng)]
        return SplittingRepetition(math.prod(shares), runs, shares, failures)

    def make_finding(
        self, of: str, levels: Sequence[float], repetitions: Sequence[SplittingRepetition]
    ) -> Finding:
        """Return what repetitions have found."""
        runs = sum(repetition.runs for repetition in repetitions)
        about = (
            f"Margin of {of} below 0: mean of {len(repetitions)} repetitions over "
            f"{len(levels)} levels, {runs} runs and forks of runs in all."
        )
        nothing = f"No level led to a failure of {of}: rarer than `least`, or impossible."
        return self._make_finding(
            of, [repetition.probability for repetition in repetitions], runs, about, nothing
        )

    def list_levels(
        self, levels: Sequence[float], repetitions: Sequence[SplittingRepetition]
    ) -> Finding:
        """Return the levels, with the shares of runs that reached each from the one before."""
        rows = []
        for k, level in enumerate((*levels, 0.0)):
            shares = np.array(
                [repetition.shares[k] for repetition in repetitions if k < len(repetition.shares)]
            )
            name = "failure" if k == len(levels) else f"level {k + 1}"
            if len(shares):
                statistics = float(np.mean(shares)), float(np.min(shares)), float(np.max(shares))
                rows.append((name, level, *statistics, len(shares)))
        about = (
            f"Margins at which runs are forked, {int(self.per_level)} a level and repetition, and "
            "shares of them that come so far. Shares near 0 call for more runs per level."
        )
        head = "", "margin", "share", "least", "most", "repetitions"
        return Finding("Levels", about, head, tuple(rows))


def _draw_seeds(rng: np.random.Generator, count: int) -> list[int]:
    seeds: list[int] = rng.integers(0, SEEDS, count).tolist()
    return seeds


def _set_run(
    process: Process[Any],
    starts: Sequence[tuple[Any, ForkOrigin]],
    k: int,
    seeds: Sequence[int],
    first: int = 0,
) -> ForkOrigin:
    """Begin a run, or continue from one of the starts; return from what it follows."""
    if not starts:
        process.begin_run(first + k, seeds[k])
        return ForkOrigin(first + k, ((0, seeds[k]),))
    state, before = starts[k]
    process.go_on(state, seeds[k])
    return ForkOrigin(before.index, (*before.seeds, (process.now, seeds[k])))
