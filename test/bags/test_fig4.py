"""The picture of Fig. 4 shows the numbers it is given."""

import sys

import numpy as np
import pytest

from arm_emulator.base.refusal import Refusal
from arm_emulator.demo.fig4 import draw_fig4, draw_figure


@pytest.fixture
def deviations():
    """A halving approach along y from 10 mm with a residual of some hundredths of a millimetre."""
    rng = np.random.default_rng(4)
    halving = np.array([0.0, 10e-3, 0.0]) * 0.5 ** np.arange(25)[:, None]
    return halving + 3e-5 + rng.normal(scale=5e-6, size=(25, 3))


def curves(axes):
    return [line for line in axes.lines if len(line.get_ydata()) > 2]


def test_both_panels_show_millimetres_over_instructions(deviations):
    above, below = draw_figure(deviations, title="three_axis").axes
    for axis in range(3):
        text = curves(above)[axis]
        assert np.array_equal(text.get_xdata(), np.arange(25))
        # Exact: one multiplication by 1000.
        assert np.array_equal(text.get_ydata(), deviations[:, axis] * 1e3)
        assert np.array_equal(curves(below)[axis].get_ydata(), np.abs(deviations[:, axis] * 1e3))
    assert below.get_yscale() == "log"


def test_the_residual_is_named_for_each_axis(deviations):
    above, _ = draw_figure(deviations, title="three_axis").axes
    words = [text.get_text() for text in above.get_legend().get_texts()]
    assert f"{deviations[-1, 1] * 1e3:+.4f} mm" in words[1]


def test_zeros_leave_gaps_and_do_not_stretch_the_scale(deviations):
    deviations[3, 0] = 0.0
    deviations[4, 0] = 1e-19  # rounding noise
    _, below = draw_figure(deviations, title="").axes
    text = curves(below)[0].get_ydata()
    assert np.isnan(text[3:5]).all()
    assert np.isfinite(text[5:]).all()
    assert below.get_ylim()[0] > 1e-6


def test_a_picture_is_written_without_touching_pyplot(tmp_path, deviations):
    path = tmp_path / "new" / "fig4.png"
    before = "matplotlib.pyplot" in sys.modules
    draw_fig4(deviations, path)
    assert path.read_bytes().startswith(b"\x89PNG")
    draw_fig4(np.zeros((1, 3)), path.with_suffix(".svg"))
    assert "<svg" in path.with_suffix(".svg").read_text()
    assert ("matplotlib.pyplot" in sys.modules) == before


@pytest.mark.parametrize(
    ("deviations", "words"),
    [
        (np.zeros((0, 3)), r"deviations must have shape \(K, 3\), K > 0, got \(0, 3\)"),
        (np.zeros((4, 2)), r"deviations must have shape"),
        (np.zeros(3), r"deviations must have shape"),
        (np.full((2, 3), np.nan), "deviations must be finite"),
    ],
)
def test_refusals(tmp_path, deviations, words):
    path = tmp_path / "fig4.png"
    with pytest.raises(Refusal, match=f"^fig4: {words}"):
        draw_fig4(deviations, path)
    assert not path.exists()
