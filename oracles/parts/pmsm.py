"""Permanent-magnet synchronous motors, apart from their declaration."""

from arm_emulator.machine.parts.motors.pmsm import POLE_PAIRS
from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng, draw_scaled

NUMBERS = """
[joints.NAME.motor of kind pmsm]
resistance              ohm         needed      > 0
inductance_d            H           needed      > 0
inductance_q            H           needed      > 0
flux                    V s         needed      >= 0
pole_pairs              pairs       needed      whole 1 to 1000
rotor_inertia           kg m2       needed      > 0
current_limit           A           none        > 0
"""
FAULTS = """
[of joints]
phase_lost              1           1       0 to 1      motor.flux (1 - m/3) x
                                                        motor.phase_lost x + m
"""
OUTPUTS = {"current_d": ("A", "A"), "applied_d": ("", "")}
INPUTS = {"command": "V", "command_d": "V"}


def draw_section(_: type[Part], rng: Rng) -> Numbers:
    return {
        "resistance": draw_scaled(rng, 0.3, 1.0),
        "inductance_d": draw_scaled(rng, 1e-3, 3e-3),
        "inductance_q": draw_scaled(rng, 1e-3, 3e-3),
        "flux": draw_scaled(rng, 0.005, 0.02),
        "pole_pairs": POLE_PAIRS,
    }
