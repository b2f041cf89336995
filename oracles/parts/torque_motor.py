"""Motors with ideal torque control, apart from their declaration."""

from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng

NUMBERS = """
[joints.NAME.motor of kind torque]
rotor_inertia           kg m2       needed      > 0
bandwidth               Hz          none        > 0
torque_limit            N m         none        > 0
"""
INPUTS = {"command": "N m"}


def draw_section(_: type[Part], rng: Rng) -> Numbers:
    return {"torque_limit": 0.5, **({"bandwidth": 200.0} if rng.random() < 0.5 else {})}
