"""Temperature of gears, apart from its declaration."""

from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng, draw_scaled

NUMBERS = """
[joints.NAME.gear.thermal]
heat_capacity           J/K         needed      > 0
thermal_resistance      K/W         needed      > 0
ambient                 degC        20          -50 to 150
reference               degC        20          -50 to 150
viscous_floor           1           0           0 to 1
viscous_decay           K           none        5 to 1e4
dry_coefficient         1/K         0           -0.02 to 0.02
winding_resistance      K/W         none        > 0
"""
FAULTS = """
[of joints]
air_around_gear_warms   K           20      -100 to 100  gear.thermal.ambient x + m
"""
ON_BASE = "Warm<Friction>{}", "Dv"


def draw_section(_: type[Part], rng: Rng) -> Numbers:
    """A small body, which friction heats by some K in the seconds of a test."""
    return {
        "heat_capacity": draw_scaled(rng, 0.05, 0.5),
        "thermal_resistance": draw_scaled(rng, 0.5, 5.0),
        "viscous_floor": float(rng.uniform(0.0, 0.5)),
        "viscous_decay": draw_scaled(rng, 10.0, 50.0),
        "dry_coefficient": float(rng.uniform(-0.01, 0.01)),
    }
