"""Gears with a kinematic error, apart from their declaration."""

from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng, draw_scaled
from oracles.parts import elastic_gear

NUMBERS = """
[joints.NAME.gear with kinematic_error with stiffness]
ratio                   link turns per motor turn  needed  size > 0, <= 1000
stiffness               N m/rad     needed      > 0
damping                 N m s/rad   0           >= 0
"""


def draw_section(part: type[Part], rng: Rng) -> Numbers:
    gear = elastic_gear.draw_section(part, rng)
    of_motor = [2.0, 0.1 * gear["ratio"], float(rng.uniform(0.0, 6.0))]
    of_link = [3.0, draw_scaled(rng, 1e-4, 1e-2)]
    return gear | {"kinematic_error": {"motor": [of_motor], "link": [of_link]}}
