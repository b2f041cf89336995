"""Loops that hold the current of a motor, apart from their declaration."""

from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng, draw_scaled

NUMBERS = """
[joints.NAME.motor.current_loop]
bandwidth               Hz          none        > 0
proportional_gain       V/A         none        > 0
integral_gain           V/(A s)     none        >= 0
emf_feedforward         1           1           0 to 1
"""
ON_BASE = "CurrentLoop<DcMotor>{{}, {}, {1.0, 1.0, 1.0, 1.0}}", "R"


def draw_section(_: type[Part], rng: Rng) -> Numbers:
    """By its bandwidth, or by its gains."""
    if rng.random() < 0.5:
        return {"bandwidth": draw_scaled(rng, 100.0, 1000.0)}
    share = float(rng.uniform(0.0, 1.0))
    return {
        "proportional_gain": draw_scaled(rng, 1.0, 10.0),
        "integral_gain": draw_scaled(rng, 100.0, 5e3),
        "emf_feedforward": share,
    }
