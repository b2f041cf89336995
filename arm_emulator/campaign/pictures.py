"""Pictures of a campaign: margins of requirements, and influences on them."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[Any]
Columns = Mapping[str, Array]
HOLDS, FAILS, INK = "#4878a8", "#d1495b", "#22313f"
MOST_POINTS = 4000
WIDTH = 10.2  # inches
_STYLE = {
    "font.size": 9.5,
    "font.family": "sans-serif",
    "axes.edgecolor": "#9aa7b2",
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": "#5b6b78",
    "ytick.color": "#5b6b78",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "figure.facecolor": "white",
    "text.parse_math": False,  # names in a campaign are text
    "figure.constrained_layout.w_pad": 0.12,  # inches
    "figure.constrained_layout.h_pad": 0.08,
}


NO_BREAK = "\N{NO-BREAK SPACE}"


def _figure(width: float, height: float, rows: int, columns: int) -> tuple[Figure, list[Axes]]:
    import matplotlib as mpl

    mpl.use("Agg", force=False)
    from matplotlib import pyplot as plt

    mpl.rcParams.update(_STYLE)  # type: ignore[arg-type]
    figure, axes = plt.subplots(
        rows, columns, figsize=(width, height), squeeze=False, layout="constrained"
    )
    return figure, list(axes.flat)


def png(figure: Figure) -> bytes:
    """Return a figure as a PNG, and close it."""
    from matplotlib import pyplot as plt

    stream = io.BytesIO()
    figure.savefig(stream, dpi=140, metadata={"Software": "arm_emulator"})
    plt.close(figure)
    return stream.getvalue()


def influence(columns: Columns, varying: Sequence[str], of: str) -> dict[str, float]:
    """Return the share of a column's variance that each varied number explains alone.

    It is the correlation ratio of ranks over slices of equally many runs, less the share of chance:
    0 without influence, 1 if nothing else matters.
    """
    values = columns[of]
    sound = np.isfinite(values)
    count = int(np.count_nonzero(sound))
    slices = min(20, count // 10)
    found = dict.fromkeys(varying, 0.0)
    if slices < 2 or np.ptp(values[sound]) == 0.0:
        return found
    ranks = np.argsort(np.argsort(values[sound], kind="stable"), kind="stable")
    whole = float(np.var(ranks))
    for name in varying:
        order = np.argsort(columns[name][sound], kind="stable")
        within = sum(float(np.var(one)) * len(one) for one in np.array_split(ranks[order], slices))
        unexplained = within / (count * whole) * (count - 1) / (count - slices)
        found[name] = max(0.0, 1.0 - unexplained)
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def margins(columns: Columns, requirements: Mapping[str, str], units: Mapping[str, str]) -> Figure:
    """Draw a histogram of each requirement's margin.

    Args:
        columns: of the results.
        requirements: columns of robustness, and their titles.
        units: of columns.
    """
    count = len(requirements)
    across = 2 if count == 4 else min(3, count)
    down = -(-count // across)
    figure, axes = _figure(WIDTH, 2.3 * down, down, across)
    for axis, (name, title) in zip(axes, requirements.items(), strict=False):
        values = columns[name][np.isfinite(columns[name])]
        axis.set_title(wrapped(title, 24), loc="left")
        if len(values):
            alike = np.ptp(values) <= 1e-9 * np.abs(values).max()  # no 60 bars are between them
            edges = np.histogram_bin_edges(values, bins=1 if alike else 60)
            low, high = edges[0], edges[-1]
            if low < 0.0 < high:  # no bar has both kinds
                edges = np.unique(np.append(edges, 0.0))
            for kind, color in ((values >= 0.0, HOLDS), (values < 0.0, FAILS)):
                axis.hist(values[kind], edges.tolist(), color=color, linewidth=0.0)
            axis.axvline(0.0, color=INK, linewidth=1.0)
        failed = int(np.count_nonzero(~(columns[name] >= 0.0)))
        word = f"{failed} of {len(columns[name])} fail" if failed else "no run fails"
        axis.set_title(word, loc="right", color=FAILS if failed else HOLDS, fontweight="normal")
        axis.set_xlabel(f"{_in('margin', units.get(name))}: < 0 fails")
        axis.set_yticks([])
        axis.spines["left"].set_visible(False)
    for axis in axes[count:]:
        axis.set_visible(False)
    return figure


def influences(
    columns: Columns,
    varying: Sequence[str],
    requirements: Mapping[str, str],
    units: Mapping[str, str],
) -> Figure:
    """Draw the influences on each requirement's margin, and the margin over the two strongest."""
    count = len(requirements)
    figure, axes = _figure(WIDTH, 2.7 * count, count, 3)
    rng = np.random.default_rng(0)
    some = np.sort(rng.permutation(len(next(iter(columns.values()))))[:MOST_POINTS])
    for row, (name, title) in enumerate(requirements.items()):
        bars, *scatters = axes[3 * row : 3 * row + 3]
        strongest = influence(columns, varying, name)
        _bars(bars, dict(list(strongest.items())[:7]), title)
        values = columns[name]
        for axis, of in zip(scatters, [*strongest, *[None] * 2], strict=False):
            if of is None:
                axis.set_visible(False)
                continue
            _cloud(axis, columns[of][some], values[some])
            axis.set_xlabel(wrapped(_in(short(of), units.get(of))))
        scatters[0].set_ylabel(_in("margin", units.get(name)))
    return figure


def _bars(axis: Axes, strongest: Mapping[str, float], title: str) -> None:
    names = list(strongest)[::-1]
    axis.barh(range(len(names)), [strongest[name] for name in names], color=HOLDS, height=0.62)
    axis.set_yticks(range(len(names)), [wrapped(short(name), 34) for name in names], fontsize=8.5)
    axis.set_xlim(0.0, 1.0)
    axis.tick_params(axis="y", length=0)
    axis.set_title(wrapped(title, 34))
    axis.set_xlabel("share of the margin's spread")


def _cloud(axis: Axes, x: Array, y: Array) -> None:
    sound = np.isfinite(y)
    for kind, color, size in ((y >= 0.0, HOLDS, 5.0), (y < 0.0, FAILS, 8.0)):
        at = sound & kind
        axis.scatter(x[at], y[at], s=size, color=color, alpha=0.45, linewidths=0.0,
                     rasterized=True)  # fmt: skip
    axis.margins(0.03)
    inside = y[sound]
    if len(inside) and -np.ptp(inside) <= np.max(inside) and np.min(inside) <= np.ptp(inside):
        axis.axhline(0.0, color=INK, linewidth=0.8)  # farther away it would squeeze the cloud


def _in(name: str, unit: str | None) -> str:
    """Return a name with its unit, which stays on one line: N m/rad is not m/rad."""
    return f"{name} [{unit.replace(' ', NO_BREAK)}]" if unit else name


def wrapped(text: str, width: int = 26) -> str:
    """Return a text in lines of at most `width` letters, broken after dots, underscores, blanks.

    A label that is longer than its panel is cut off, or covers that of the next panel.
    """
    lines = [""]
    for word in re.findall(rf"[^._ ]{{1,{width - 1}}}[._ ]*|[._ ]+", text):
        if lines[-1] and len(lines[-1]) + len(word.rstrip()) > width:
            lines.append("")
        lines[-1] += word
    return "\n".join(line.rstrip() for line in lines)


def short(name: str) -> str:
    """Return a name without its common prefix."""
    return name.removeprefix("joints.").replace("controller.joints.", "").removeprefix("scenario.")
