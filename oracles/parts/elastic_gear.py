"""Elastic gears, apart from their declaration."""

from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng, draw_scaled
from oracles.parts import gear as rigid_gear

NUMBERS = """
[joints.NAME.gear with stiffness]
ratio                   link turns per motor turn  needed  size > 0, <= 1000
stiffness               N m/rad     needed      > 0
damping                 N m s/rad   0           >= 0
"""


def draw_section(part: type[Part], rng: Rng) -> Numbers:
    gear = rigid_gear.draw_section(part, rng)
    stiffness, damping = draw_scaled(rng, 1e3, 1e4), draw_scaled(rng, 0.5, 10.0)
    return gear | {"stiffness": stiffness, "damping": damping}
