"""Ripple of a motor's torque, apart from its declaration."""

from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng

NUMBERS = """
[joints.NAME.motor.ripple]
"""
ON_BASE = "RippledMotor<DcMotor, 1>{}", "R"


def draw_section(_: type[Part], rng: Rng) -> Numbers:
    return {"waves": [[6.0, float(rng.uniform(0.01, 0.1)), 1.0]]}
