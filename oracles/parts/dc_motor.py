"""DC motors, apart from their declaration."""

from arm_emulator.machine.parts.part import Part
from oracles.part_truths import Numbers, Rng, draw_scaled

NUMBERS = """
[joints.NAME.motor of kind dc]
resistance              ohm         needed      > 0
inductance              H           0           >= 0
torque_constant         N m/A       needed      > 0
back_emf_constant       V s/rad     needed      >= 0
rotor_inertia           kg m2       needed      > 0
current_limit           A           none        > 0
"""
INPUTS = {"command": "V"}


def draw_section(_: type[Part], rng: Rng) -> Numbers:
    inductive = rng.random() < 0.5
    return {
        "resistance": draw_scaled(rng, 0.5, 2.0),
        "torque_constant": 0.05,
        "back_emf_constant": 0.05,
        **({"inductance": draw_scaled(rng, 1e-3, 5e-3)} if inductive else {}),
        **({"current_limit": draw_scaled(rng, 3.0, 10.0)} if rng.random() < 0.5 else {}),
    }
