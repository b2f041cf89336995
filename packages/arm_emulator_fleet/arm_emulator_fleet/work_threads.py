"""A fleet's arms in shares, each worked on by one thread at a time."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

SHARES_OF_WORKER = 4
WORTH_A_THREAD = 5000  # steps of arms in one call, before anything is measured
LARGEST = 20  # bits: larger work goes as that
# Below this a thread costs more than it can take over [s]: the calling thread waits for it longer
# than the call lasts, and finds its data in the other core's cache.
SHORT = 1e-4
SPENT_ON_TRIALS = 0.01  # share of the time: machines change, so the slower way is tried again
REMEMBERED = 0.5  # share of what was measured before that counts beside the newest
OUTLIER = 4.0  # times what was measured before: longer ones, other programs' work, count as that
GAIN = 0.9  # sharing goes on below this share of the time alone: its time varies more


class WorkThreads:
    """Threads that share the work on arms, in whole groups of lanes.

    Whether sharing pays depends on the work and on what else the machine does, so it is measured:
    work of about the same size goes the quicker way. The calling thread works, too, and does all
    the work until another thread has woken up.

    Attributes:
        workers: threads, the calling one among them.

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
        self._saved: dict[int, float] = {}  # s that trials may take, by size
        self._short = 0  # work that is shorter than SHORT in one thread
        self.start_threads()

    def start_threads(self) -> None:
        """Start threads, whatever happened to earlier ones."""
        self._pool = ThreadPoolExecutor(self.workers - 1) if self.workers > 1 else None

    def end_threads(self) -> None:
        """Let the threads end; none works between two calls of `do_work`.

        Does not wait for them: the collector of garbage may call from one of them.
        """
        if self._pool:
            self._pool.shutdown(wait=False)

    def do_work(self, worth: int, work: Callable[[int, int], object]) -> None:
        """Do work(first, arms) on all arms.

        Args:
            worth: steps of arms that it takes.
            work: may be called by several threads at a time.
        """
        if self._pool is None or not worth:
            work(0, self._count)
            return
        began = time.perf_counter()
        if worth <= self._short:
            work(0, self._count)
            if time.perf_counter() - began > SHORT:
                self._short = 0
            return
        size = min(worth.bit_length(), LARGEST)
        shared = self._is_shared_quicker(size, worth)
        if shared:
            self._run_shared(self._pool, work)
        else:
            work(0, self._count)
        self._note_time(size, shared, worth, time.perf_counter() - began)

    def _run_shared(self, pool: ThreadPoolExecutor, work: Callable[[int, int], object]) -> None:
        left = iter(self._shares)

        def take_shares() -> None:
            for share in left:
                work(*share)

        others = [pool.submit(take_shares) for _ in range(self.workers - 1)]
        try:
            take_shares()
        finally:
            for future in others:
                if not future.cancel():
                    future.result()

    def _is_shared_quicker(self, size: int, worth: int) -> bool:
        alone, shared = (self._taken.get((size, exclusive)) for exclusive in (False, True))
        if alone is None or shared is None:
            return worth > WORTH_A_THREAD if alone is shared else shared is None
        slower = max(alone, shared) * worth
        tries = self._saved.get(size, 0.0) > slower
        if tries:
            self._saved[size] -= slower
        return (shared < GAIN * alone) is not tries

    def _note_time(self, size: int, shared: bool, worth: int, spent: float) -> None:
        if not shared and spent < SHORT:
            self._short = max(self._short, worth)
        self._saved[size] = self._saved.get(size, 0.0) + SPENT_ON_TRIALS * spent
        taken = spent / worth
        before = self._taken.get((size, shared), taken)
        newest = min(taken, OUTLIER * before)
        self._taken[size, shared] = REMEMBERED * before + (1.0 - REMEMBERED) * newest
