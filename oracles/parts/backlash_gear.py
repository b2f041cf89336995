"""Gears with play, apart from their declaration."""

from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng, draw_scaled
from oracles.parts import elastic_gear

NUMBERS = """
[joints.NAME.gear with backlash with stiffness]
ratio                   link turns per motor turn  needed  size > 0, <= 1000
stiffness               N m/rad     needed      > 0
damping                 N m s/rad   0           >= 0
backlash                rad         needed      >= 0
"""
FAULTS = """
[of joints]
backlash_grows          rad         1e-3    0 to 1      gear.backlash x + m
"""


def draw_section(part: type[Part], rng: Rng) -> Numbers:
    return elastic_gear.draw_section(part, rng) | {"backlash": draw_scaled(rng, 1e-3, 2e-2)}
