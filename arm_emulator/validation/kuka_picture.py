"""Pictures of the KUKA KR300 beside a measured run."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

from arm_emulator.validation.kuka_kr300 import Comparison

matplotlib.use("Agg")
from matplotlib import pyplot as plt

EVERY = 5  # free runs: one of this many is drawn


def draw(one: Comparison, names: tuple[str, ...], file: Path) -> None:
    """Draw torques, free runs and wind-up of each axis."""
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
