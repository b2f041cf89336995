"""Work on a fleet goes to as many threads as it is quicker with."""

from __future__ import annotations

import threading

import pytest

from arm_emulator.machine import shares as shares_module
from arm_emulator.machine.shares import Shares

ALL = 64  # arms


@pytest.mark.parametrize(
    ("of_share", "of_all", "shared"), [(1e-4, 4e-3, True), (4e-3, 1e-4, False)]
)
def test_work_goes_the_way_that_was_quicker(
    of_share: float, of_all: float, shared: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a clock on which each piece of work takes its time after the others."""
    shares = Shares(ALL, 8, 2)
    done: list[tuple[int, int]] = []
    now, turn = [0.0], threading.Lock()
    monkeypatch.setattr(shares_module.time, "perf_counter", lambda: now[0])

    def work(first: int, arms: int) -> None:
        with turn:
            now[0] += of_all if arms == ALL else of_share
            done.append((first, arms))

    for _ in range(2):
        shares.do(1000, work)  # each way once
    assert sum(arms for _, arms in done) == 2 * ALL
    assert (0, ALL) in done and len(done) > 2
    done.clear()
    for _ in range(5):
        shares.do(1000, work)
    assert len(done) == (5 * 8 if shared else 5)
    done.clear()
    for _ in range(100):
        shares.do(1000, work)
    ways = sum(arms == ALL for _, arms in done)
    assert ways == (1 if shared else 99), "the slower way is tried once in a hundred calls"
    shares.end()


def test_large_work_begins_on_all_threads() -> None:
    for worth, calls in ((100, 1), (10**6, 8)):
        shares = Shares(ALL, 8, 2)
        done: list[int] = []
        shares.do(worth, lambda first, _, done=done: done.append(first))  # type: ignore[misc]
        assert sorted(done) == sorted(range(0, ALL, ALL // calls))
        shares.end()
