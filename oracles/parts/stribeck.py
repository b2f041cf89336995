"""Friction that falls as a shaft begins to slide, apart from its declaration."""

from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng
from oracles.parts import friction

NUMBERS = f"""
[joints.NAME.friction with stribeck]
[joints.NAME.motor.friction with stribeck]
{friction.NUMBERS_OF_FRICTIONS}\
stribeck                rad/s       needed      > 0
"""


def draw_section(part: type[Part], rng: Rng) -> Numbers:
    return friction.draw_section(part, rng) | {"stribeck": friction.find_usual_speed(part)}
