"""Pictures of the Manutec r3 beside the independent solution."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np

from arm_emulator.validation.manutec_r3 import AXES, Comparison, Motion, solution

matplotlib.use("Agg")
from matplotlib import pyplot as plt


def draw(motion: Motion, by_period: Sequence[tuple[float, Comparison]], file: Path) -> None:
    """Draw angles, currents, friction modes, and the error over the period."""
    truth, modes, _, _ = solution()
    figure, ((angles, currents), (sticking, errors)) = plt.subplots(
        2, 2, figsize=(12, 7.5), layout="constrained"
    )
    for j in range(AXES):
        colour = f"C{j}"
        for axes, name in ((angles, "q"), (currents, "current")):
            values = getattr(motion, name)[:, j]
            axes.plot(motion.t, values, color=colour, label=f"axis {j + 1}")
            axes.plot(truth.t[::60], getattr(truth, name)[::60, j], ".", color=colour, ms=4)
        lift = 2.5 * j
        sticking.plot(motion.t, motion.friction_mode[:, j] + lift, color=colour, lw=1)
        sticking.plot(truth.t[::20], modes[::20, j] + lift, ".", color=colour, ms=3)
    angles.set(title="link angles (points: the solution)", xlabel="s", ylabel="rad")
    angles.legend(loc="upper right", fontsize="small", ncols=2)  # "best" is slow
    currents.set(title="motor currents", xlabel="s", ylabel="A")
    sticking.set(title="slides back, sticks, slides on", xlabel="s")
    sticking.set(yticks=2.5 * np.arange(AXES), yticklabels=[f"axis {j + 1}" for j in range(AXES)])
    period = np.array([one for one, _ in by_period])
    off = np.array([[c.q.max(), c.current.max()] for _, c in by_period])
    errors.loglog(1e6 * period, off[:, 0], "o-", label="angles, rad")
    errors.loglog(1e6 * period, off[:, 1], "s-", label="currents, A")
    errors.loglog(1e6 * period, off[-1, 0] * (period / period[-1]) ** 2, "k:", label="order 2")
    errors.set(title="largest difference", xlabel="servo period = step, us")
    errors.legend(loc="lower right", fontsize="small")
    for axes in (angles, currents, sticking, errors):
        axes.grid(alpha=0.3)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110)
    plt.close(figure)
