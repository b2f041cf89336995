"""Cogging of motors, apart from its declaration."""

from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng, draw_scaled

NUMBERS = """
[joints.NAME.motor.cogging]
"""


def draw_section(_: type[Part], rng: Rng) -> Numbers:
    return {"waves": [[4.0, draw_scaled(rng, 1e-3, 1e-2), float(rng.uniform(0.0, 6.0))]]}
