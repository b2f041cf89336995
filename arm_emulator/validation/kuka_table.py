"""Tables of the KUKA KR300 beside its measured runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from arm_emulator.machine.scene import load_scene
from arm_emulator.validation.figure import table_of
from arm_emulator.validation.kuka_kr300 import SHIPPED, Comparison, compare

WIDTH = 150  # characters of the tables


def validate_kuka(runs: Sequence[Path], folder: Path, console: Console) -> dict[str, Any]:
    """Compare with runs, print, draw into a folder, and return the same for programs.

    Args:
        runs: files as run_A.npz; none: the shipped ones.
        folder: of the pictures.
        console: for the tables.

    Raises:
        Refusal: a file is not such a run.
    """
    scene = load_scene("kuka_kr300")
    paths = list(runs) or list(SHIPPED)
    found = [
        compare(path, scene) for path in track(paths, "kuka_kr300", console=Console(stderr=True))
    ]
    compared = []
    for one in found:
        title = f"KUKA KR300, identified on run A, beside {one.run.where}"
        console.print(table_of(title, scene.joint_names, one.figures))
        picture = folder / f"kuka_kr300_{Path(one.run.where).stem}.png"
        draw(one, scene.joint_names, picture)
        for failure in one.failures:
            console.print(f"[red]{failure}")
        console.print(f"{one.run.where}: {'good' if one.good else 'NOT GOOD'}; picture: {picture}")
        figures = [
            {"title": f.title, "values": f.values, "mean": f.mean, "limits": f.limits}
            for f in one.figures
        ]
        compared.append(
            {
                "record": one.run.where,
                "good": one.good,
                "failures": one.failures,
                "figures": figures,
                "picture": picture,
            }
        )
    return {"good": all(one.good for one in found), "runs": compared}


EVERY = 5  # free runs: one of this many is drawn


def draw(one: Comparison, names: tuple[str, ...], file: Path) -> None:
    """Draw torques, free runs and wind-up of each axis."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    N, data, run = len(names), one.data, one.run
    figure, axes = plt.subplots(N, 3, figsize=(15, 1.9 * N), layout="constrained", sharex=True)
    for j, (row, name) in enumerate(zip(axes, names, strict=True)):
        torque, free, wound = row
        moving = np.where(data.moving[:, j], 1.0, np.nan)
        torque.plot(data.t, data.tau[:, j], color="0.6", lw=1.2)
        torque.plot(data.t, one.torques[:, j] * moving, "C0", lw=1.0)
        torque.plot(data.t, (data.tau - one.torques)[:, j] * moving, "C3", lw=0.7)
        torque.set_ylabel(name)
        free.plot(run.t, np.degrees(run.q_motor[:, j]), color="0.6", lw=1.2)
        for k in range(0, len(one.begins), EVERY):
            at = one.begins[k]
            t = run.t[at + 1 : at + 1 + len(one.paths)]
            free.plot(t, np.degrees(one.paths[:, k, j]), "C0", lw=1.0)
        if np.isfinite(one.wind_up.measured[:, j]).any():
            t, measured = one.wind_up.t, np.degrees(one.wind_up.measured[:, j])
            computed = np.degrees(one.wind_up.computed[:, j])
            wound.plot(t, measured, color="0.6", lw=0.8)
            wound.plot(t, computed, "C0", lw=1.0)
            wound.plot(t, measured - computed, "C3", lw=0.6)
        else:
            wound.set_axis_off()
        for each in row:
            each.grid(alpha=0.3)
    titles = ("torque at the link, N m, below 10 Hz", "motor at the link, deg: free runs",
              "wind-up, deg")  # fmt: skip
    for each, title in zip(axes[0], titles, strict=True):
        each.set_title(f"{title}\ngrey: measured, blue: computed, red: residual", fontsize="small")
    for each in axes[-1]:
        each.set_xlabel("s")
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=85)
    plt.close(figure)
