"""Processes that simulate runs of a campaign together, and how far they are."""

from __future__ import annotations

import concurrent.futures as cf
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, Self, TypeVar

from arm_emulator.extension.base import Refusal
from arm_emulator_campaign.campaign_file import Campaign
from arm_emulator_campaign.worker import Done

CHUNK = 1.5  # s of simulation: more than a task costs, and little to lose
LARGEST_CHUNK = 100_000  # runs
MOST_BREAKS = 3  # of pools that end without a finished chunk
Left = TypeVar("Left")


class Pool(Protocol):
    """Processes that work, here or elsewhere."""

    @property
    def breaks(self) -> tuple[type[BaseException], ...]:
        """Exceptions of work whose process was killed; another pool can go on."""

    @property
    def workers(self) -> int:
        """Number of its processes at this time; at least 1."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> cf.Future[Any]:
        """Submit a call."""

    def end(self) -> None:
        """Let the workers write finished runs, and end."""


@dataclass
class Progress:
    """Progress of a campaign.

    Attributes:
        count: of runs in all.
        before: runs that were done when it began.
        done: runs since then.
        failures: of each requirement, and of any last, in all of these.
        began: when it began, by `time.monotonic`.
    """

    count: int
    before: int
    done: int = 0
    failures: list[int] = field(default_factory=list)
    began: float = field(default_factory=time.monotonic)

    def add(self, found: Done) -> None:
        """Count the result of a chunk."""
        self.done += found.runs
        pairs = zip(self.failures, found.failures, strict=True)
        self.failures = [before + more for before, more in pairs]

    def late(self, seconds: float) -> bool:
        """Whether so much wall time has passed."""
        return time.monotonic() - self.began >= seconds

    @property
    def rate(self) -> float:
        """Runs per second of wall time."""
        return self.done / max(1e-9, time.monotonic() - self.began)

    @property
    def left(self) -> float:
        """Seconds that the rest will take; NaN: not known yet."""
        rest = self.count - self.before - self.done
        return rest / self.rate if self.done else math.nan


@dataclass(frozen=True)
class WorkerPool:
    """Processes that simulate, and who is informed of it.

    Attributes:
        make_pool: makes processes; called again after one of them was killed.
        seconds: of a run, measured beforehand.
        report: is called after each chunk.
    """

    make_pool: Callable[[], Pool]
    seconds: float
    report: Callable[[Progress], None]

    @property
    def largest(self) -> int:
        """Runs of a chunk, at most."""
        return max(1, min(LARGEST_CHUNK, round(CHUNK / self.seconds)))


class Work:
    """Work of a pool: where one of its processes is killed, others do what is left.

    Use it as a context, at whose end the processes end.

    Args:
        campaign: whose runs these are.
        crew: does it.
        progress: of this work; a chunk that is done counts there.
    """

    def __init__(self, campaign: Campaign, crew: WorkerPool, progress: Progress) -> None:
        self._campaign, self._crew, self._progress = campaign, crew, progress
        self._pool: Pool | None = None

    def complete(
        self,
        missing: Callable[[int], Sequence[Left]],
        work: Callable[[Pool, Sequence[Left], int], None],
    ) -> None:
        """Call work(pool, missing(killed), killed), again for each pool that is killed.

        Raises:
            Refusal: pools end again and again without a finished chunk.
        """
        breaks = killed = 0
        while left := missing(killed):
            before = self._progress.done
            pool = self._pool = self._pool or self._crew.make_pool()
            try:
                return work(pool, left, killed)
            except pool.breaks:
                killed += 1
                breaks = breaks + 1 if self._progress.done == before else 0
                self.end()
            if breaks >= MOST_BREAKS:
                where, ended = self._campaign.where, f"ended {breaks} times"
                raise Refusal(where, "workers", "not end by themselves", ended)

    def end(self) -> None:
        """End the processes."""
        pool, self._pool = self._pool, None
        if pool is not None:
            pool.end()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()
