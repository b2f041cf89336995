"""Rigid gears, apart from their declaration."""

from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng, draw_scaled

NUMBERS = """
[joints.NAME.gear]
ratio                   link turns per motor turn  needed  size > 0, <= 1000
"""


def draw_section(_: type[Part], rng: Rng) -> Numbers:
    return {"ratio": draw_scaled(rng, 0.01, 0.04) * float(rng.choice([-1.0, 1.0]))}
