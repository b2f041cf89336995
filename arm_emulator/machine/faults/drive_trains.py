"""Faults of gears, bearings, stops and springs."""

from __future__ import annotations

from arm_emulator.machine.parts.fault import Fault, falling, rise, rising, share

FAULTS = (
    Fault(
        "gear_breaks",
        "the gear carries only a share of its torque, at 1 none",
        sets=falling("gear.stiffness", "gear.damping", "gear.cubic_stiffness"),
        magnitude=share(),
    ),
    Fault(
        "gear_softens",
        "the gear's stiffness falls",
        sets=falling("gear.stiffness"),
        magnitude=share(0.5, 0.999),
    ),
    Fault(
        "gear_rings", "the gear's damping falls", sets=falling("gear.damping"), magnitude=share()
    ),
    Fault(
        "friction_steps",
        "dry friction of the link rises",
        sets=rising("friction.coulomb"),
        magnitude=rise("N m", 5.0, 1e6),
    ),
    Fault(
        "grease_thickens",
        "viscous friction of the link rises",
        sets=rising("friction.viscous"),
        magnitude=rise("N m s/rad", 5.0, 1e6),
    ),
    Fault(
        "gear_runs_dry",
        "friction rises with the load on the gear",
        sets=rising("friction.load", "motor.friction.load"),
        magnitude=rise("N m/(N m)", 0.1, 1.0),
    ),
    Fault(
        "bearing_binds",
        "dry friction of the rotor rises",
        sets=rising("motor.friction.coulomb"),
        magnitude=rise("N m", 0.1, 1e6),
    ),
    Fault(
        "bearing_drags",
        "viscous friction of the rotor rises",
        sets=rising("motor.friction.viscous"),
        magnitude=rise("N m s/rad", 1e-3, 1e6),
    ),
)
