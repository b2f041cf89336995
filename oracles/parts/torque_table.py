"""Torques from tables, apart from their declaration."""

import numpy as np

from arm_emulator.machine.parts.joint_effects.torque_table import MIN_POINTS
from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng

NUMBERS = """
[joints.NAME.torque_table]
"""


def draw_section(_: type[Part], rng: Rng) -> Numbers:
    angles = np.cumsum(rng.uniform(0.05, 0.4, int(rng.integers(MIN_POINTS, 12)))) - 1.5
    torques = rng.uniform(-5.0, 5.0, len(angles))
    periodic = bool(rng.random() < 0.5)
    if periodic:
        torques[-1] = torques[0]
    return {"angles": angles.tolist(), "torques": torques.tolist(), "periodic": periodic}
