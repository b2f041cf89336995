"""The paper's Fig. 4: the distance of the tool from its target over the instructions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_emulator.base.refusal import Refusal

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AXES = "xyz"
COLOURS = ("#2a6fb0", "#d9731a", "#3c8f4f")
MARKERS = "os^"
MAX_MARKS = 60


def draw_fig4(
    deviations: ArrayLike,
    path: str | Path,
    *,
    title: str = "Deviation of the tool from its target",
) -> None:
    """Draw the deviation over the number of instructions into a picture file.

    Args:
        deviations: target minus tool before each instruction, (K, 3) [m]; row 0 is the start.
        path: file to write; its suffix chooses the format.
        title: shown above.

    Raises:
        Refusal: a wrong shape, no rows, or numbers that are not finite.
    """
    figure = draw_figure(deviations, title=title)
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)


def draw_figure(deviations: ArrayLike, *, title: str) -> Figure:
    """Return the figure that `draw_fig4` writes, with the same arguments.

    Above, the deviation as the paper shows it; below, its magnitude on a logarithmic scale.
    """
    from matplotlib.figure import Figure  # not pyplot: no screen, no global state

    d = np.asarray(deviations, dtype=np.float64) * 1e3  # mm
    if d.ndim != 2 or d.shape[1] != len(AXES) or d.size == 0:
        raise Refusal("fig4", "deviations", "have shape (K, 3), K > 0", d.shape)
    if not np.isfinite(d).all():
        raise Refusal("fig4", "deviations", "be finite [m]", "NaN or infinity")
    figure = Figure(figsize=(8.0, 7.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    figure.suptitle(title, fontsize=13)
    _draw_signed(above, d)
    _draw_magnitude(below, d)
    for axes in (above, below):
        axes.grid(True, color="0.9", linewidth=0.8)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _draw_signed(axes: Axes, d: NDArray[np.float64]) -> None:
    axes.axhline(0.0, color="0.4", linewidth=0.8)
    for axis, colour, marker, values in zip(AXES, COLOURS, MARKERS, d.T, strict=True):
        label = f"{axis}    residual {values[-1]:+.4f} mm"
        axes.plot(values, color=colour, linewidth=1.6, label=label, **_choose_marks(marker, values))
    axes.set_ylabel("target − tool [mm]")
    axes.legend(frameon=False, loc="best")


def _choose_marks(marker: str, values: NDArray[np.float64]) -> dict[str, Any]:
    """Return marks at the instructions, or at some of very many."""
    return {"marker": marker, "markersize": 4, "markevery": max(1, len(values) // MAX_MARKS)}


def _draw_magnitude(axes: Axes, d: NDArray[np.float64]) -> None:
    from matplotlib.ticker import MaxNLocator

    axes.set_yscale("log")
    # Values far below the residual, or below 1 nm, must not stretch the scale.
    nothing = max(1e-3 * float(np.linalg.norm(d[-1])), 1e-6)
    magnitude = np.where(np.abs(d) < nothing, np.nan, np.abs(d))
    for colour, marker, values in zip(COLOURS, MARKERS, magnitude.T, strict=True):
        axes.plot(values, color=colour, linewidth=1.2, **_choose_marks(marker, values))
    axes.set_ylabel("|target − tool| [mm]")
    axes.set_xlabel("number of instructions")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    axes.margins(x=0.02)
