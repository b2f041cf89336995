"""Pictures of measured and computed torques."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

from arm_emulator.identification.filtered import Filtered
from arm_emulator.machine.chain import Array

matplotlib.use("Agg")
from matplotlib import pyplot as plt


def draw_torques(data: Filtered, torques: Array, names: tuple[str, ...], file: Path,
                 title: str) -> None:  # fmt: skip
    """Draw measured torques, those of the fit, and their difference."""
    N = len(names)
    figure, axes = plt.subplots(
        N, 1, figsize=(10, 1.7 * N + 0.6), sharex=True, squeeze=False, layout="constrained"
    )
    for j, (one, name) in enumerate(zip(axes[:, 0], names, strict=True)):
        moving = np.where(data.moving[:, j], 1.0, np.nan)
        one.plot(data.t, data.tau[:, j], color="0.6", lw=1.0, label="measured")
        one.plot(data.t, torques[:, j] * moving, "C0", lw=1.2, label="computed, in motion")
        one.plot(data.t, (data.tau - torques)[:, j] * moving, "C3", lw=0.8, label="residual")
        one.set_ylabel(f"{name}\nN m")
        one.grid(alpha=0.3)
    axes[0, 0].set_title(title)
    axes[0, 0].legend(fontsize="small", ncols=3)
    axes[-1, 0].set_xlabel("s")
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=100)
    plt.close(figure)
