"""Picture of `tune`: steps, sensitivities, tracking errors, for present and computed gains."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import matplotlib
import numpy as np

from arm_emulator.design.tuned import Tuned
from arm_emulator.machine.scene import Scene

matplotlib.use("Agg")
from matplotlib import pyplot as plt

ROWS = 400


def draw(scene: Scene, pair: Mapping[str, Tuned], file: Path) -> None:
    """Draw both sets of gains, the present ones dashed, each joint in a colour of its own."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(15, 4.5), layout="constrained")
    period = scene.servo_period
    span = max(6.0 / one.position_gain for tuned in pair.values() for one in tuned.loops.joints)
    every = max(1, round(span / period / ROWS))
    for label, line in (("present", "--"), ("computed", "-")):
        tuned = pair[label]
        loop = tuned.loops.loops[0]
        w, S = loop.sensitivities()
        for j, name in enumerate(scene.joint_names):
            colour, shown = f"C{j}", name if label == "computed" else None
            q = loop.step(j, ROWS, every)[:, j]
            left.plot(1e3 * period * every * np.arange(ROWS), q, line, color=colour, label=shown)
            frequency = w / (2.0 * math.pi * period)
            middle.loglog(frequency, np.abs(S[:, j]), line, color=colour)
            t = period * np.arange(len(tuned.run.off))
            right.plot(t, 1e3 * tuned.run.off[:, j], line, color=colour)
    left.set(title="step of a joint's target", xlabel="ms", ylabel="link / target")
    left.legend(fontsize="small")
    middle.axhline(2.0, color="grey", linewidth=0.8)
    middle.set(
        title="amplification of disturbances",
        xlabel="Hz",
        ylabel="|1 / (1 + L)|",
        ylim=(1e-3, 10.0),
    )
    right.set(title="smooth move: link less target", xlabel="s", ylabel="mrad (mm)")
    for axes in (left, middle, right):
        axes.grid(alpha=0.3)
    figure.suptitle(f"{scene.name} at its start: present gains dashed, computed ones solid")
    figure.savefig(file, dpi=90)
    plt.close(figure)
