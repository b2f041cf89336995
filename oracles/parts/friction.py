"""Friction of links and of rotors, apart from its declaration."""

from arm_emulator.machine.parts.frictions.friction import OfRotor
from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng, draw_scaled

NUMBERS_OF_FRICTIONS = """\
viscous                 N m s/rad   0           >= 0
coulomb                 N m         0           >= 0
breakaway               N m         coulomb     >= coulomb
"""
NUMBERS = f"""
[joints.NAME.friction]
[joints.NAME.motor.friction]
{NUMBERS_OF_FRICTIONS}"""


def draw_section(part: type[Part], rng: Rng) -> Numbers:
    dry_scale, viscous = (0.01, 1e-5) if issubclass(part, OfRotor) else (0.6, 0.1)
    dry = dry_scale * draw_scaled(rng, 0.3, 3.0)
    return {"coulomb": dry, "breakaway": 1.3 * dry, "viscous": viscous}


def find_usual_speed(part: type[Part]) -> float:
    """Return a slow speed of the shaft [rad/s]."""
    return 6.0 if issubclass(part, OfRotor) else 0.2
