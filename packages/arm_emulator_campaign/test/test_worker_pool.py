"""Work that goes on although processes are killed."""

import math
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from arm_emulator.base.refusal import Refusal
from arm_emulator_campaign.execution.executor import size_chunk
from arm_emulator_campaign.execution.worker_pool import (
    MAX_BREAKS,
    CampaignProgress,
    Work,
    WorkerPool,
)
from arm_emulator_campaign.simulation.batch_simulator import WIDTH


class Killed(Exception):
    """A process of a pool was killed."""


@dataclass
class APool:
    breaks = (Killed,)
    ended = 0

    def end_workers(self):
        self.ended += 1


def work_of(kills, done_before_each):
    """Work on 12 pieces whose first pools are killed; the pools, and pieces that each has found."""
    pools, left, missing_runs = [], list(range(12)), []

    def make_pool():
        pools.append(APool())
        return pools[-1]

    progress = CampaignProgress(12, 0)
    worker_pool = WorkerPool(make_pool, 1.0, lambda progress: None)

    def work(pool, missing, killed):
        assert pool is pools[-1] and killed == len(pools) - 1
        missing_runs.append(list(missing))
        if killed < kills:
            del left[:done_before_each]
            progress.done += done_before_each
            raise Killed
        left.clear()

    with Work(SimpleNamespace(where="campaign"), worker_pool, progress) as all_of_it:
        try:
            all_of_it.complete_missing(lambda killed: list(left), work)
        finally:
            ended = [pool.ended for pool in pools]
    assert [pool.ended for pool in pools] == [1] * len(pools), "each ends, and once"
    return missing_runs, ended


def test_another_pool_does_the_rest():
    work, ended = work_of(5, 2)
    assert [len(piece) for piece in work] == [12, 10, 8, 6, 4, 2]
    assert ended == [1] * 5 + [0], "a pool that was not killed is there for more work"


def test_nothing_left_needs_no_pool():
    assert work_of(6, 2) == work_of(7, 2)  # the sixth kill came after the last piece
    assert len(work_of(6, 2)[0]) == 6


def test_pools_that_end_without_any_result_are_refused():
    assert len(work_of(MAX_BREAKS - 1, 0)[0]) == MAX_BREAKS
    with pytest.raises(Refusal, match=f"end by themselves, got ended {MAX_BREAKS}"):
        work_of(MAX_BREAKS, 0)


def test_workers_that_are_equally_quick_end_together():
    rng = np.random.default_rng(2)
    for _ in range(300):
        runs, largest = (int(10 ** rng.uniform(0, ends)) for ends in (7, 4))
        workers = int(rng.integers(1, 50))
        size = size_chunk(runs, workers, largest)
        rounds = math.ceil(math.ceil(runs / size) / workers)  # each takes the next when it is free
        assert 1 <= size <= largest
        # No later than if all were divided evenly, but for a group of lanes in each chunk.
        assert size * rounds <= runs / workers + rounds * (WIDTH + 1)
        assert size < WIDTH or size % WIDTH == 0 or size == largest
