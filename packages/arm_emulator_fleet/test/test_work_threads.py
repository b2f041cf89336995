"""Work on a fleet goes to as many threads as it is quicker with."""

import threading

import pytest

from arm_emulator_fleet import work_threads as shares_module
from arm_emulator_fleet.work_threads import SHORT, WorkThreads

ALL = 64  # arms


class Clock:
    """On which each piece of work takes its time after the others."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, of_share: float, of_all: float) -> None:
        self.now, self._turn, self._of = 0.0, threading.Lock(), [of_share, of_all]
        self.done: list[tuple[int, int]] = []
        monkeypatch.setattr(shares_module.time, "perf_counter", lambda: self.now)

    def of_share(self, taken: float) -> None:
        self._of[0] = taken

    def work(self, first: int, arms: int) -> None:
        with self._turn:
            self.now += self._of[arms == ALL]
            self.done.append((first, arms))


@pytest.mark.parametrize(
    ("of_share", "of_all", "shared"), [(1e-4, 4e-3, True), (4e-3, 2e-4, False)]
)
def test_work_is_divided_as_was_quicker(
    of_share: float, of_all: float, shared: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    shares, clock = WorkThreads(ALL, 8, 2), Clock(monkeypatch, of_share, of_all)
    for _ in range(2):
        shares.do_work(1000, clock.work)  # each way once
    assert sum(arms for _, arms in clock.done) == 2 * ALL
    assert (0, ALL) in clock.done and len(clock.done) > 2
    clock.done.clear()
    for _ in range(5):
        shares.do_work(1000, clock.work)
    assert len(clock.done) == (5 * 8 if shared else 5)
    clock.done.clear()
    began = clock.now
    while not clock.done or (clock.done[-1] == (0, ALL)) is not shared:
        shares.do_work(1000, clock.work)
    slower = of_all if shared else 8 * of_share
    assert clock.now - began > 50 * slower, "trials of the slower way take a hundredth of the time"
    shares.end_threads()


def test_sharing_that_is_quick_now_and_then_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every other call wakes the other thread in time, and the rest wait for it."""
    shares, clock = WorkThreads(ALL, 8, 2), Clock(monkeypatch, 0.0, 1e-3)
    for call in range(3000):
        clock.of_share(3e-5 if call % 2 == 0 else 4e-4)
        shares.do_work(1000, clock.work)
    assert clock.now < 3000 * 1e-3 * 1.1, "not a tenth more than in one thread"
    shares.end_threads()


def test_short_work_stays_in_the_calling_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    shares, clock = WorkThreads(ALL, 8, 2), Clock(monkeypatch, 1e-9, 0.9 * SHORT)
    for _ in range(10_000):
        shares.do_work(1000, clock.work)
    assert set(clock.done) == {(0, ALL)}
    shares.end_threads()


def test_the_calling_thread_does_the_remaining_work() -> None:
    """The other thread is busy: nothing waits for it."""
    shares, free = WorkThreads(ALL, 8, 2), threading.Event()
    done: list[int] = []
    first: list[threading.Thread] = []

    def work(begins: int, _: int) -> None:
        done.append(begins)
        if threading.current_thread() is not threading.main_thread():
            free.wait(10.0)

    first.append(threading.Thread(target=lambda: shares.do_work(10**6, work)))
    first[0].start()  # takes a share, and its helper another; both wait
    while len(done) < 2:
        pass
    shares.do_work(10**6, lambda begins, _: done.append(1000 + begins))
    assert sorted(index for index in done if index >= 1000) == [1000 + 8 * k for k in range(8)]
    free.set()
    first[0].join()
    assert sorted(index for index in done if index < 1000) == [8 * k for k in range(8)]
    shares.end_threads()


def test_large_work_begins_on_all_threads() -> None:
    for worth, calls in ((100, 1), (10**6, 8)):
        shares = WorkThreads(ALL, 8, 2)
        done: list[int] = []
        shares.do_work(worth, lambda first, _, done=done: done.append(first))  # type: ignore[misc]
        assert sorted(done) == sorted(range(0, ALL, ALL // calls))
        shares.end_threads()


def test_the_last_work_may_end_the_threads() -> None:
    """As where the collector of garbage deletes a fleet in a thread of its shares."""
    shares = WorkThreads(ALL, 8, 2)
    pool = shares._pool
    assert pool is not None
    assert pool.submit(shares.end_threads).result(timeout=60.0) is None
