"""Hybrid stepper motors, apart from their declaration."""

from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng, draw_scaled

NUMBERS = """
[joints.NAME.motor of kind stepper]
torque_per_current      N m/A       needed      > 0
resistance              ohm         0           >= 0
teeth                   teeth       needed      whole 1 to 1000
rotor_inertia           kg m2       needed      > 0
bandwidth               Hz          needed      > 0
current_limit           A           none        > 0
"""
OUTPUTS = {"applied_b": ("", "")}
INPUTS = {"command": "A", "command_b": "A"}


def draw_section(_: type[Part], rng: Rng) -> Numbers:
    return {
        "torque_per_current": draw_scaled(rng, 0.03, 0.1),
        "teeth": int(rng.integers(1, 5)),
        "bandwidth": draw_scaled(rng, 100.0, 500.0),
    }
