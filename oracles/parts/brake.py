"""Brakes, apart from their declaration."""

from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng, draw_scaled

NUMBERS = """
[joints.NAME.brake]
torque                  N m         needed      > 0
close_delay             s           0           0 to 10
release_delay           s           0           0 to 10
"""
FAULTS = """
[of joints]
brake_slips             1           0.9     0 to 1      brake.torque (1 - m) x
brake_stays_open        1           1       0 to 1      brake.closed (1 - m) x
brake_drags             1           1       0 to 1      brake.closed 1 - (1 - x) (1 - m)
"""
OUTPUTS = {"brake_closed": ("", "")}
ON_BASE = "Braked<Friction>{}", "Dv"


def draw_section(_: type[Part], rng: Rng) -> Numbers:
    """With delays of whole steps of 0.5 ms."""
    close, release = (5e-4 * int(n) for n in rng.integers(0, 30, 2))
    return {"torque": draw_scaled(rng, 0.02, 0.5), "close_delay": close, "release_delay": release}
