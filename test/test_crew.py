"""Work that goes on although processes are killed."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import pytest

from arm_emulator.base.refusal import Refusal
from arm_emulator.campaign.crew import MOST_BREAKS, Crew, Progress, Work


class Killed(Exception):
    """A process of a pool was killed."""


@dataclass
class APool:
    breaks = (Killed,)
    ended = 0

    def end(self):
        self.ended += 1


def work_of(kills, done_before_each):
    """Work on 12 pieces whose first pools are killed; the pools, and pieces that each has found."""
    pools, left, found = [], list(range(12)), []

    def make_pool():
        pools.append(APool())
        return pools[-1]

    progress = Progress(12, 0)
    crew = Crew(make_pool, 1.0, lambda progress: None)

    def work(pool, missing, killed):
        assert pool is pools[-1] and killed == len(pools) - 1
        found.append(list(missing))
        if killed < kills:
            del left[:done_before_each]
            progress.done += done_before_each
            raise Killed
        left.clear()

    with Work(SimpleNamespace(where="campaign"), crew, progress) as all_of_it:
        try:
            all_of_it.complete(lambda killed: list(left), work)
        finally:
            ended = [pool.ended for pool in pools]
    assert [pool.ended for pool in pools] == [1] * len(pools), "each ends, and once"
    return found, ended


def test_another_pool_does_what_is_left():
    found, ended = work_of(5, 2)
    assert [len(one) for one in found] == [12, 10, 8, 6, 4, 2]
    assert ended == [1] * 5 + [0], "a pool that was not killed is there for more work"


def test_nothing_left_needs_no_pool():
    assert work_of(6, 2) == work_of(7, 2)  # the sixth kill came after the last piece
    assert len(work_of(6, 2)[0]) == 6


def test_pools_that_end_without_any_result_are_refused():
    assert len(work_of(MOST_BREAKS - 1, 0)[0]) == MOST_BREAKS
    with pytest.raises(Refusal, match=f"end by themselves, got ended {MOST_BREAKS}"):
        work_of(MOST_BREAKS, 0)
