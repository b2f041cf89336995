"""Pictures of a campaign: margins of requirements, influences on them, and all runs."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator_campaign.search.method import Finding

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[Any]
Columns = Mapping[str, Array]
HOLDS, FAILS, INK = "#4878a8", "#d1495b", "#22313f"
MAX_LINES, MAX_POINTS, MAX_AXES = 150, 4000, 10  # lines: of each kind
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


def _make_figure(width: float, height: float, rows: int, columns: int) -> tuple[Figure, list[Axes]]:
    import matplotlib as mpl

    mpl.use("Agg", force=False)
    from matplotlib import pyplot as plt

    mpl.rcParams.update(_STYLE)  # type: ignore[arg-type]
    figure, axes = plt.subplots(
        rows, columns, figsize=(width, height), squeeze=False, layout="constrained"
    )
    return figure, list(axes.flat)


def encode_png(figure: Figure) -> bytes:
    """Return a figure as a PNG, and close it."""
    from matplotlib import pyplot as plt

    stream = io.BytesIO()
    figure.savefig(stream, dpi=140, metadata={"Software": "arm_emulator"})
    plt.close(figure)
    return stream.getvalue()


def compute_influence(columns: Columns, varying: Sequence[str], of: str) -> dict[str, float]:
    """Return the share of a column's variance that each varied number explains alone.

    It is the correlation ratio of ranks over slices of equally many runs, less the share of chance:
    0 without influence, 1 if nothing else matters.
    """
    values = columns[of]
    sound = np.isfinite(values)
    count = int(np.count_nonzero(sound))
    slices = min(20, count // 10)
    influence = dict.fromkeys(varying, 0.0)
    if slices < 2 or np.ptp(values[sound]) == 0.0:
        return influence
    ranks = np.argsort(np.argsort(values[sound], kind="stable"), kind="stable")
    total_variance = float(np.var(ranks))
    for name in varying:
        order = np.argsort(columns[name][sound], kind="stable")
        within = sum(
            float(np.var(part)) * len(part) for part in np.array_split(ranks[order], slices)
        )
        unexplained = within / (count * total_variance) * (count - 1) / (count - slices)
        influence[name] = max(0.0, 1.0 - unexplained)
    return dict(sorted(influence.items(), key=lambda item: -item[1]))


def draw_margins(
    columns: Columns, requirements: Mapping[str, str], units: Mapping[str, str]
) -> Figure:
    """Draw a histogram of each requirement's margin.

    Args:
        columns: of the results.
        requirements: columns of robustness, and their titles.
        units: of columns.
    """
    count = len(requirements)
    across = 2 if count == 4 else min(3, count)
    down = -(-count // across)
    figure, axes = _make_figure(WIDTH, 2.3 * down, down, across)
    for axis, (name, title) in zip(axes, requirements.items(), strict=False):
        values = columns[name][np.isfinite(columns[name])]
        axis.set_title(wrap_text(title, 24), loc="left")
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
        axis.set_xlabel(f"{_add_unit('margin', units.get(name))}: < 0 fails")
        axis.set_yticks([])
        axis.spines["left"].set_visible(False)
    for axis in axes[count:]:
        axis.set_visible(False)
    return figure


def draw_influences(
    columns: Columns,
    varying: Sequence[str],
    requirements: Mapping[str, str],
    units: Mapping[str, str],
) -> Figure:
    """Draw the influences on each requirement's margin, and the margin over the two strongest."""
    count = len(requirements)
    figure, axes = _make_figure(WIDTH, 2.7 * count, count, 3)
    rng = np.random.default_rng(0)
    some = np.sort(rng.permutation(len(next(iter(columns.values()))))[:MAX_POINTS])
    for row, (name, title) in enumerate(requirements.items()):
        bars, *scatters = axes[3 * row : 3 * row + 3]
        strongest = compute_influence(columns, varying, name)
        _draw_bars(bars, dict(list(strongest.items())[:7]), title)
        values = columns[name]
        for axis, of in zip(scatters, [*strongest, *[None] * 2], strict=False):
            if of is None:
                axis.set_visible(False)
                continue
            _draw_cloud(axis, columns[of][some], values[some])
            axis.set_xlabel(wrap_text(_add_unit(shorten_name(of), units.get(of))))
        scatters[0].set_ylabel(_add_unit("margin", units.get(name)))
    return figure


def draw_finding(finding: Finding) -> Figure:
    """Draw a column of a finding as bars, a panel for each output."""
    at = finding.head.index(finding.bars)
    outputs = list(dict.fromkeys(row[0] for row in finding.rows))
    across = min(3, len(outputs))
    down = -(-len(outputs) // across)
    figure, axes = _make_figure(WIDTH, 2.6 * down, down, across)
    for axis, output in zip(axes, outputs, strict=False):
        rows = [row for row in finding.rows if row[0] == output][:7][::-1]
        sizes, errors = [[float(row[k]) for row in rows] for k in (at, at + 1)]
        axis.barh(range(len(rows)), sizes, xerr=errors, color=HOLDS, height=0.62,
                  error_kw={"ecolor": INK, "elinewidth": 1.0})  # fmt: skip
        names = [wrap_text(shorten_name(str(row[1])), 34) for row in rows]
        axis.set_yticks(range(len(rows)), names, fontsize=8.5)
        axis.set_xlim(0.0, None)
        axis.tick_params(axis="y", length=0)
        axis.set_title(wrap_text(str(output)))
        axis.set_xlabel(finding.bars)
    for axis in axes[len(outputs) :]:
        axis.set_visible(False)
    return figure


def _draw_bars(axis: Axes, strongest: Mapping[str, float], title: str) -> None:
    names = list(strongest)[::-1]
    axis.barh(range(len(names)), [strongest[name] for name in names], color=HOLDS, height=0.62)
    axis.set_yticks(
        range(len(names)), [wrap_text(shorten_name(name), 34) for name in names], fontsize=8.5
    )
    axis.set_xlim(0.0, 1.0)
    axis.tick_params(axis="y", length=0)
    axis.set_title(wrap_text(title, 34))
    axis.set_xlabel("share of the margin's spread")


def _draw_cloud(axis: Axes, x: Array, y: Array) -> None:
    sound = np.isfinite(y)
    for kind, color, size in ((y >= 0.0, HOLDS, 5.0), (y < 0.0, FAILS, 8.0)):
        at = sound & kind
        axis.scatter(x[at], y[at], s=size, color=color, alpha=0.45, linewidths=0.0,
                     rasterized=True)  # fmt: skip
    axis.margins(0.03)
    inside = y[sound]
    if len(inside) and -np.ptp(inside) <= np.max(inside) and np.min(inside) <= np.ptp(inside):
        axis.axhline(0.0, color=INK, linewidth=0.8)  # farther away it would squeeze the cloud


def draw_coordinates(
    columns: Columns, varying: Sequence[str], failed: Array, ranks: NDArray[np.int64]
) -> Figure:
    """Draw runs as lines over all varied numbers, failed and others in turns.

    So neither kind hides the other, however many there are of each.

    Args:
        columns: of the results.
        varying: numbers that vary; the first `MAX_AXES` are drawn.
        failed: whether each run failed (K,).
        ranks: its place among the worst, by which lines are chosen (K,).
    """
    from matplotlib.collections import LineCollection

    names = [*varying[:MAX_AXES]]
    figure, (axis,) = _make_figure(WIDTH, 3.6, 1, 1)
    order = np.argsort(-ranks, kind="stable")
    bad = order[failed[order]][-MAX_LINES:]
    good = order[~failed[order]]
    good = good[np.linspace(0, len(good) - 1, min(len(good), MAX_LINES)).astype(int)]
    heights = np.array([_scale_values(columns[name]) for name in names])
    runs = np.random.default_rng(0).permutation(np.concatenate([bad, good]))
    lines = [np.column_stack([np.arange(len(names)), heights[:, run]]) for run in runs]
    colors = [FAILS if failed[run] else HOLDS for run in runs]
    axis.add_collection(
        LineCollection(lines, colors=colors, alpha=0.4, linewidths=0.8, rasterized=True)
    )
    for place, name in enumerate(names):
        axis.axvline(place, color="#9aa7b2", linewidth=0.8)
        low, high = float(np.min(columns[name])), float(np.max(columns[name]))
        axis.text(place, 1.03, f"{high:.3g}", ha="center", va="bottom", fontsize=8)
        axis.text(place, -0.03, f"{low:.3g}", ha="center", va="top", fontsize=8)
    axis.set_xlim(-0.4, len(names) - 0.6)
    axis.set_ylim(-0.12, 1.12)
    axis.set_xticks(range(len(names)), [wrap_text(shorten_name(name), 12) for name in names])
    axis.tick_params(length=0)
    axis.set_yticks([])
    for side in ("left", "bottom"):
        axis.spines[side].set_visible(False)
    return figure


def _scale_values(values: Array) -> Array:
    low, high = float(np.min(values)), float(np.max(values))
    scaled: Array = (values - low) / (high - low) if high > low else np.full(len(values), 0.5)
    return scaled


def _add_unit(name: str, unit: str | None) -> str:
    """Return a name with its unit, which stays on one line: N m/rad is not m/rad."""
    return f"{name} [{unit.replace(' ', NO_BREAK)}]" if unit else name


def wrap_text(text: str, width: int = 26) -> str:
    """Return a text in lines of at most `width` letters, broken after dots, underscores, blanks.

    A label that is longer than its panel is cut off, or covers that of the next panel.
    """
    lines = [""]
    for word in re.findall(rf"[^._ ]{{1,{width - 1}}}[._ ]*|[._ ]+", text):
        if lines[-1] and len(lines[-1]) + len(word.rstrip()) > width:
            lines.append("")
        lines[-1] += word
    return "\n".join(line.rstrip() for line in lines)


def shorten_name(name: str) -> str:
    """Return a name without its common prefix."""
    return name.removeprefix("joints.").replace("controller.joints.", "").removeprefix("scenario.")
