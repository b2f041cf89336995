"""Motors with ideal current control, apart from their declaration."""

from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng

NUMBERS = """
[joints.NAME.motor of kind current]
torque_constant         N m/A       needed      > 0
resistance              ohm         0           >= 0
rotor_inertia           kg m2       needed      > 0
bandwidth               Hz          none        > 0
current_limit           A           none        > 0
"""
INPUTS = {"command": "A"}


def draw_section(_: type[Part], rng: Rng) -> Numbers:
    numbers = {"torque_constant": 0.05, "current_limit": 10.0}
    return {**numbers, **({"bandwidth": 200.0} if rng.random() < 0.5 else {})}
