"""A fleet's arms in shares, each worked on by one thread at a time."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

SHARES_OF_WORKER = 4
WORTH_A_THREAD = 5000  # steps of arms in one call, before anything is measured
LARGEST = 20  # bits: larger work goes as that
TRIED_AGAIN = 100  # calls after which the slower way is tried once more: machines change
REMEMBERED = 0.8  # share of what was measured before that counts beside the newest


class Shares:
    """Threads that share the work on arms, in whole groups of lanes.

    Whether sharing pays depends on the work and on what else the machine does, so it is measured:
    work of about the same size goes the quicker way.

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
        self._taken: dict[tuple[int, bool], float] = {}  # s of a unit of work, by size and way
        self._calls: dict[int, int] = {}
        self.hire()

    def hire(self) -> None:
        """Start threads, whatever happened to earlier ones."""
        self._pool = ThreadPoolExecutor(self.workers) if self.workers > 1 else None

    def end(self) -> None:
        """End the threads."""
        if self._pool:
            self._pool.shutdown()

    def do(self, worth: int, work: Callable[[int, int], object]) -> None:
        """Do work(first, arms) on all arms.

        Args:
            worth: steps of arms that it takes.
            work: may be called by several threads at a time.
        """
        if self._pool is None or not worth:
            work(0, self._count)
            return
        size = min(worth.bit_length(), LARGEST)
        shared = self._goes_shared(size, worth)
        began = time.perf_counter()
        if shared:
            list(self._pool.map(lambda share: work(*share), self._shares))
        else:
            work(0, self._count)
        taken = (time.perf_counter() - began) / worth
        before = self._taken.get((size, shared), taken)
        self._taken[size, shared] = min(taken, REMEMBERED * before + (1.0 - REMEMBERED) * taken)

    def _goes_shared(self, size: int, worth: int) -> bool:
        calls = self._calls[size] = self._calls.get(size, 0) + 1
        alone, shared = (self._taken.get((size, way)) for way in (False, True))
        if alone is None or shared is None:
            return worth > WORTH_A_THREAD if alone is shared else shared is None
        quicker = shared < alone
        return not quicker if calls % TRIED_AGAIN == 0 else quicker
