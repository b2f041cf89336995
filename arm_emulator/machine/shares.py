"""A fleet's arms in shares, each worked on by one thread at a time."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

SHARES_OF_WORKER = 4
WORTH_A_THREAD = 5000  # steps of arms in one call; fewer take no longer than it takes to share them


class Shares:
    """Threads that share the work on arms, in whole groups of lanes.

    Attributes:
        workers: threads.

    Args:
        count: of arms.
        lanes: arms of a group.
        workers: threads at most.
    """

    def __init__(self, count: int, lanes: int, workers: int) -> None:
        groups = -(-count // lanes)
        self._count = count
        self.workers = min(workers, groups)
        # More shares than workers: cores need not be equally fast.
        shares = min(SHARES_OF_WORKER * self.workers if self.workers > 1 else 1, groups)
        bounds = [groups * k // shares * lanes for k in range(shares + 1)]
        self._shares = [
            (first, min(end, count) - first) for first, end in itertools.pairwise(bounds)
        ]
        self.hire()

    def hire(self) -> None:
        """Have threads, whatever became of those before."""
        self._pool = ThreadPoolExecutor(self.workers) if self.workers > 1 else None

    def end(self) -> None:
        """Let the threads go."""
        if self._pool:
            self._pool.shutdown()

    def do(self, worth: int, work: Callable[[int, int], object]) -> None:
        """Do work(first, arms) on all arms.

        Args:
            worth: steps of arms that it takes.
            work: may be called by several threads at a time.
        """
        if self._pool and worth > WORTH_A_THREAD:
            list(self._pool.map(lambda share: work(*share), self._shares))
        else:
            work(0, self._count)
