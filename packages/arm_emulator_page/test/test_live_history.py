"""Rows of a running machine in bounded memory: what is kept, and what a plot gets of it."""

import math
import random

import numpy as np
import pytest
from draws import some

from arm_emulator_page.live_page import MAX_ROWS, NEWEST, LiveHistory

KIND = np.dtype([("t", "f8"), ("tick", "i8"), ("q", "f8", (2,))])


def rows(begin: int, end: int) -> np.ndarray:
    ticks = np.arange(begin, end)
    table = np.zeros(len(ticks), KIND)
    table["tick"], table["t"], table["q"] = ticks, 1e-3 * ticks, ticks[:, None]
    return table


@pytest.mark.parametrize("seed", some(range(50), 8))
def test_the_newest_rows_are_complete_and_the_run_is_thinned_evenly(seed: int) -> None:
    draw, history, end = random.Random(seed), LiveHistory(KIND), 0
    last = draw.choice((50, 3000, 9000, 60_000))
    while end < last:
        begin, end = end, min(last, end + draw.randrange(0, 4000))
        history.add_rows(rows(begin, end))
    assert history.newest["tick"].tolist() == [last - 1] and history.count == last
    stored = history._thinned["tick"]
    assert len(stored) <= MAX_ROWS and stored[0] == 0 and len(history._newest) == min(last, NEWEST)
    assert len(set(np.diff(stored))) <= 1, "evenly"
    for tick in (0, last // 2, last - 1):
        every = stored[1] - stored[0] if len(stored) > 1 else 1
        near = 0 if tick >= last - NEWEST else every // 2 + 1
        assert abs(history.find_row(tick)["tick"][0] - tick) <= near
    for seconds in (0.5e-3 * last, math.inf):
        newest_rows = history.select_rows(seconds, 200)
        assert 0 < len(newest_rows) <= 200 and newest_rows["tick"][-1] == last - 1
        assert np.all(np.diff(newest_rows["t"]) > 0.0)
        assert newest_rows["t"][0] >= 1e-3 * (last - 1) - seconds


def test_a_machine_that_restarts_has_no_rows_of_before() -> None:
    history = LiveHistory(KIND)
    history.add_rows(rows(0, 500))
    history.add_rows(np.concatenate([rows(500, 600), rows(0, 20)]))
    assert history.count == 20 and history.newest["tick"][0] == 19
    history.add_rows(rows(3, 5))
    assert history.count == 2 and history.find_row(0)["tick"][0] == 3
    assert not len(LiveHistory(KIND).find_row(3)) and not len(
        LiveHistory(KIND).select_rows(1.0, 10)
    )
