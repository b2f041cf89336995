"""Stops at the ends of a joint's way, apart from their declaration."""

from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng, draw_scaled

NUMBERS = """
[joints.NAME.end_stops]
lower                   rad         needed      -1e4 to 1e4
upper                   rad         needed      -1e4 to 1e4
stiffness               N m/rad     needed      > 0
damping                 N m s/rad   0           >= 0
beyond                  rad         0           0 to 1e4
"""
FAULTS = """
[of joints]
stop_softens            1           0.9     0 to 0.999  end_stops.stiffness (1 - m) x
stop_moves              rad         0.1     -10 to 10   end_stops.lower x + m
                                                        end_stops.upper x + m
"""


def draw_section(_: type[Part], rng: Rng) -> Numbers:
    scaled = draw_scaled(rng, 0.02, 0.2)
    return {
        "lower": -scaled,
        "upper": scaled,
        "stiffness": draw_scaled(rng, 1e3, 2e4),
        "damping": 10.0,
    }
