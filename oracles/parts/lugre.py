"""LuGre friction, apart from its declaration."""

from arm_emulator.machine.parts.frictions.lugre import LinkLuGre
from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng, draw_scaled

NUMBERS = """
[joints.NAME.lugre]
[joints.NAME.motor.lugre]
coulomb                 N m         needed      > 0
breakaway               N m         coulomb     >= coulomb
stribeck                rad/s       0.1         > 0
bristle_stiffness       N m/rad     needed      > 0
bristle_damping         N m s/rad   0           >= 0
"""
FAULTS = """
[of joints]
seal_grips              N m         1       0 to 1e6    lugre.coulomb x + m
                                                        motor.lugre.coulomb x + m
"""


def draw_section(part: type[Part], rng: Rng) -> Numbers:
    if issubclass(part, LinkLuGre):
        torque = draw_scaled(rng, 0.2, 2.0)
        bend, damping, speed = (2e-3, 2e-2), (0.3, 3.0), {}
    else:
        torque = draw_scaled(rng, 0.003, 0.03)
        bend, damping, speed = (0.2, 1.0), (3e-4, 3e-3), {"stribeck": 5.0}
    return {
        "coulomb": torque,
        "breakaway": torque * float(rng.uniform(1.0, 1.5)),
        **speed,
        "bristle_stiffness": torque / draw_scaled(rng, *bend),
        "bristle_damping": draw_scaled(rng, *damping),
    }
