"""Pictures of a campaign's report."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex

from arm_emulator.campaign.pictures import FAILS, HOLDS, MOST_LINES, coordinates, png


@pytest.mark.parametrize("share", [0.01, 0.5, 0.99])
def test_no_kind_of_run_hides_the_other(share: float) -> None:
    """As many lines of each as there are, up to a limit, and in any part of the order both."""
    count, rng = 20_000, np.random.default_rng(3)
    columns = {name: rng.uniform(size=count) for name in "abc"}
    failed = rng.uniform(size=count) < share
    figure = coordinates(columns, list(columns), failed, np.where(failed, -1.0, 1.0))
    (lines,) = (one for one in figure.axes[0].collections if isinstance(one, LineCollection))
    colors = [to_hex(one) for one in lines.get_color()]
    png(figure)  # closes it
    assert colors.count(FAILS) == colors.count(HOLDS) == MOST_LINES
    # Of 150 in turns, 50 of one kind in a row are drawn once in 1e15.
    for last in (colors[-50:], colors[:50]):
        assert {FAILS, HOLDS} == set(last)
