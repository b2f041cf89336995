"""Tables of the KUKA KR300 beside its measured runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from arm_emulator.validation.kuka_kr300 import LONG, SHIPPED, Comparison, compare
from arm_emulator.validation.kuka_picture import draw
from emulator_node.chain import Array
from emulator_node.scene import load_scene


def validate_kuka(runs: Sequence[Path], folder: Path) -> int:
    """Compare with runs, print, draw into a folder; exit code 1 if one is not close enough.

    Args:
        runs: files as run_A.npz; none: those that come along.
        folder: of the pictures.

    Raises:
        Refusal: a file that is no such run.
    """
    scene = load_scene("kuka_kr300")
    paths = list(runs) or list(SHIPPED)
    found = [
        compare(path, scene) for path in track(paths, "kuka_kr300", console=Console(stderr=True))
    ]
    console = Console(width=max(110, Console().width))
    console.print(_table(found, scene.joint_names))
    for one in found:
        picture = folder / f"kuka_kr300_{Path(one.run.where).stem}.png"
        draw(one, scene.joint_names, picture)
        console.print(f"{one.run.where}: {'good' if one.good else 'NOT GOOD'}; picture: {picture}")
    return 0 if all(one.good for one in found) else 1


def _table(found: Sequence[Comparison], names: tuple[str, ...]) -> Table:
    table = Table(title="KUKA KR300, identified on run A, beside measured runs")
    table.add_column("")
    for name in (*names, "mean"):
        table.add_column(name, justify="right")
    for one in found:
        short, long = (100.0 * drift.share for drift in one.drifts)
        rows: list[tuple[str, Array, str, Array | None]] = [
            ("torque explained in motion, %", one.explained, ".1f", one.explained),
            (f"free run of {LONG[0]:g} s, % off", short, ".1f", short),
            (f"free run of {LONG[1]:g} s, % off", long, ".1f", long),
            ("wind-up, deg rms", np.degrees(one.wind_up.unexplained), ".4f", None),
            ("  of it not computed", np.degrees(one.wind_up.residual), ".4f", None),
            ("  encoder's ripple apart", np.degrees(one.wind_up.rest), ".4f", None),
            ("  ripple, deg", np.degrees(one.wind_up.ripple), ".4f", None),
            ("  its waves per turn", one.wind_up.order, ".0f", None),
        ]
        if (closed := one.closed_loop) is not None:
            rows += [
                ("our servo: torque explained, %", closed.explained, ".1f", closed.explained),
                ("  behind its command, deg rms", np.degrees(closed.lag), ".4f", None),
                ("  real controller, deg rms", np.degrees(closed.measured_lag), ".4f", None),
            ]
        for title, values, form, mean in rows:
            shown = [format(value, form) if np.isfinite(value) else "" for value in values]
            last = "" if mean is None else format(float(mean.mean()), form)
            table.add_row(f"{Path(one.run.where).stem}: {title}", *shown, last)
    return table
