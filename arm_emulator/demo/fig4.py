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
MOST_MARKS = 60


def draw_fig4(
    deviations: ArrayLike,
    bound: ArrayLike,
    path: str | Path,
    *,
    title: str = "Deviation of the tool from its target",
) -> None:
    """Draw the deviation over the number of instructions into a picture file.

    Args:
        deviations: target minus tool before each instruction, (K, 3) [m]; row 0 is the start.
        bound: predicted residual, (3,) [m]: +- the errors of encoders and gears.
        path: file to write; its suffix chooses the format.
        title: shown above.

    Raises:
        Refusal: wrong shapes, no rows, numbers that are not finite, or a negative bound.
    """
    figure = fig4(deviations, bound, title=title)
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)


def fig4(deviations: ArrayLike, bound: ArrayLike, *, title: str) -> Figure:
    """Return the figure that `draw_fig4` writes, with the same arguments.

    Above, the deviation as the paper shows it; below, its magnitude on a logarithmic scale, where
    the residual can be read against the prediction.
    """
    from matplotlib.figure import Figure  # not pyplot: no screen, no global state

    d = _checked(deviations, "deviations", 2)
    limit = _checked(bound, "bound", 1)
    if (limit < 0.0).any():
        raise Refusal("fig4", "bound", "be >= 0 m", limit)
    d, limit = d * 1e3, limit * 1e3  # mm
    figure = Figure(figsize=(8.0, 7.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    figure.suptitle(title, fontsize=13)
    _draw_signed(above, d, limit)
    _draw_magnitude(below, d, limit)
    for axes in (above, below):
        axes.grid(True, color="0.9", linewidth=0.8)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _draw_signed(axes: Axes, d: NDArray[np.float64], limit: NDArray[np.float64]) -> None:
    axes.axhline(0.0, color="0.4", linewidth=0.8)
    axes.axhspan(-limit.max(), limit.max(), color="0.5", alpha=0.18, linewidth=0.0)
    for axis, colour, marker, values, most in zip(AXES, COLOURS, MARKERS, d.T, limit, strict=True):
        label = f"{axis}    residual {values[-1]:+.4f} mm, predicted within ±{most:.4f} mm"
        axes.plot(values, color=colour, linewidth=1.6, label=label, **_marks(marker, values))
    axes.set_ylabel("target − tool [mm]")
    axes.legend(frameon=False, loc="best")


def _marks(marker: str, values: NDArray[np.float64]) -> dict[str, Any]:
    """Return marks at the instructions, or at some of very many."""
    return {"marker": marker, "markersize": 4, "markevery": max(1, len(values) // MOST_MARKS)}


def _draw_magnitude(axes: Axes, d: NDArray[np.float64], limit: NDArray[np.float64]) -> None:
    from matplotlib.ticker import MaxNLocator

    axes.set_yscale("log")
    # Values far below the prediction, or below 1 nm, must not stretch the scale.
    nothing = max(1e-3 * limit.max(), 1e-6)
    magnitude = np.where(np.abs(d) < nothing, np.nan, np.abs(d))
    for colour, marker, values, most in zip(COLOURS, MARKERS, magnitude.T, limit, strict=True):
        axes.plot(values, color=colour, linewidth=1.2, **_marks(marker, values))
        if most > 0.0:
            axes.axhline(most, color=colour, linestyle="--", linewidth=1.0)
    axes.set_ylabel("|target − tool| [mm]")
    axes.set_xlabel("number of instructions    (dashed: predicted residual)")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    axes.margins(x=0.02)


def _checked(values: ArrayLike, quantity: str, dimensions: int) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != dimensions or array.shape[-1] != len(AXES) or array.size == 0:
        shape = "(K, 3), K > 0" if dimensions > 1 else "(3,)"
        raise Refusal("fig4", quantity, f"have shape {shape}", array.shape)
    if not np.isfinite(array).all():
        raise Refusal("fig4", quantity, "be finite [m]", "NaN or infinity")
    return array
