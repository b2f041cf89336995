"""Pictures of the report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from arm_emulator.machine.schemes.known import SCHEMES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Colours of our schemes; colours and markers of the others.
PALETTE = ("#2a6fb0", "#0aa5a0", "#3c8f4f", "#d9731a", "#8a6d3b", "#c44e8a", "#5b5bd6", "#7f9f2f")
COLOURS = dict(zip(SCHEMES, PALETTE, strict=False))
PEERS = {
    "MuJoCo Euler": ("#8c8c8c", "v"),
    "MuJoCo implicit": ("#b58fc7", "<"),
    "MuJoCo implicitfast": ("#7a3b96", ">"),
    "MuJoCo discrete": ("#444444", "D"),
    "MuJoCo RK4": ("#c2185b", "^"),
    "Pinocchio + SciPy RK45": ("#a9853b", "x"),
    "Pinocchio + SciPy LSODA": ("#6b5523", "+"),
}


def make_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a size in inches; no screen, no global state."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def save_picture(figure: Figure, folder: Path, name: str) -> None:
    """Write `name`.png, the same bytes for the same figures."""
    figure.savefig(folder / f"{name}.png", dpi=110)
