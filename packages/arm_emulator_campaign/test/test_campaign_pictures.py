"""Pictures of a campaign's report."""

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex

from arm_emulator_campaign.results.pictures import (
    FAILS,
    HOLDS,
    MAX_LINES,
    NO_BREAK,
    _add_unit,
    draw_coordinates,
    draw_influences,
    draw_margins,
    encode_png,
    wrap_text,
)


@pytest.mark.parametrize("share", [0.01, 0.5, 0.99])
def test_no_kind_of_run_hides_another(share: float) -> None:
    """As many lines of each as there are, up to a limit, and in any part of the order both."""
    count, rng = 20_000, np.random.default_rng(3)
    columns = {name: rng.uniform(size=count) for name in "abc"}
    failed = rng.uniform(size=count) < share
    figure = draw_coordinates(columns, list(columns), failed, np.where(failed, -1.0, 1.0))
    (lines,) = (
        collection
        for collection in figure.axes[0].collections
        if isinstance(collection, LineCollection)
    )
    colors = [to_hex(color) for color in lines.get_color()]
    encode_png(figure)  # closes it
    assert colors.count(FAILS) == colors.count(HOLDS) == MAX_LINES
    # Of 150 in turns, 50 of one kind in a row are drawn once in 1e15.
    for last in (colors[-50:], colors[:50]):
        assert {FAILS, HOLDS} == set(last)


LONG = (
    "joints.shoulder_lift_joint.motor.current_loop.proportional_gain",
    "joints.shoulder_pan_joint.gear.cubic_stiffness",
    "links.forearm_link.inertia_xx",
    "faults.push.force.2",
)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["influences", "margins", "coordinates"])
def test_long_names_are_neither_cut_off_nor_overlap(kind: str) -> None:
    rng = np.random.default_rng(4)
    columns = {name: rng.normal(size=300) for name in LONG}
    titles = {"robustness.near": "tool_stays_within_a_tenth_of_its_tolerance", "robustness.at": "b"}
    for k, of in enumerate(titles):
        columns[of] = columns[LONG[k]] + 0.1 * columns[LONG[2]]
    units = dict.fromkeys(LONG, "N m s/rad") | dict.fromkeys(titles, "N m/rad3")
    figure = {
        "influences": lambda: draw_influences(columns, LONG, titles, units),
        "margins": lambda: draw_margins(columns, titles, units),
        "coordinates": lambda: draw_coordinates(
            columns, LONG, columns["robustness.near"] < 0.0, np.arange(300)
        ),
    }[kind]()
    figure.canvas.draw()
    frame = figure.bbox
    axes = [axis for axis in figure.axes if axis.get_visible()]
    labels = [
        label.get_window_extent()
        for axis in axes
        for label in (axis.xaxis.label, axis.yaxis.label, axis.title, *axis.get_yticklabels())
        if label.get_text()
    ]
    encode_png(figure)  # closes it
    assert all(frame.x0 <= box.x0 and box.x1 <= frame.x1 for box in labels)
    assert all(frame.y0 <= box.y0 and box.y1 <= frame.y1 for box in labels)
    assert not any(
        label.overlaps(later) for k, label in enumerate(labels) for later in labels[k + 1 :]
    )


def test_a_text_is_broken_after_dots_and_stays_the_same_to_the_letter() -> None:
    text = LONG[0]
    lines = wrap_text(text, 20).split("\n")
    assert "".join(lines) == text
    assert max(map(len, lines)) <= 20
    assert all(line[-1] in "._" for line in lines[:-1])
    assert "".join(wrap_text("a" * 50, 20).split("\n")) == "a" * 50


def test_a_unit_stays_on_a_single_line() -> None:
    label = wrap_text(_add_unit("joints.shoulder.gear.stiffness", "N m/rad"))
    assert [line.replace(NO_BREAK, " ") for line in label.split("\n")][-1].endswith("[N m/rad]")
