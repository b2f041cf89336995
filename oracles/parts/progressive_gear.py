"""Gears that stiffen as they wind up, apart from their declaration."""

from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng, draw_scaled
from oracles.parts import elastic_gear

NUMBERS = """
[joints.NAME.gear with cubic_stiffness with stiffness]
ratio                   link turns per motor turn  needed  size > 0, <= 1000
stiffness               N m/rad     needed      > 0
damping                 N m s/rad   0           >= 0
cubic_stiffness         N m/rad3    needed      >= 0
"""


def draw_section(part: type[Part], rng: Rng) -> Numbers:
    gear = elastic_gear.draw_section(part, rng)
    return gear | {"cubic_stiffness": gear["stiffness"] * draw_scaled(rng, 1e2, 1e4)}
