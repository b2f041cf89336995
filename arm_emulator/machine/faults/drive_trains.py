"""Faults of gears, bearings, stops and springs."""

from __future__ import annotations

from arm_emulator.machine.parts.fault import Fault, falling, rise, rising, share

FAULTS = (
    Fault(
        name="gear_breaks",
        text="the gear carries only a share of its torque, at 1 none",
        sets=falling(("gear.stiffness", "gear.damping", "gear.cubic_stiffness")),
        magnitude=share(),
    ),
    Fault(
        name="gear_softens",
        text="the gear's stiffness falls",
        sets=falling(("gear.stiffness",)),
        magnitude=share(0.5, 0.999),
    ),
    Fault(
        name="gear_rings",
        text="the gear's damping falls",
        sets=falling(("gear.damping",)),
        magnitude=share(),
    ),
    Fault(
        name="friction_steps",
        text="dry friction of the link rises",
        sets=rising(("friction.coulomb",)),
        magnitude=rise("N m", 5.0, 1e6),
    ),
    Fault(
        name="grease_thickens",
        text="viscous friction of the link rises",
        sets=rising(("friction.viscous",)),
        magnitude=rise("N m s/rad", 5.0, 1e6),
    ),
    Fault(
        name="gear_runs_dry",
        text="friction rises with the load on the gear",
        sets=rising(("friction.load", "motor.friction.load")),
        magnitude=rise("N m/(N m)", 0.1, 1.0),
    ),
    Fault(
        name="bearing_binds",
        text="dry friction of the rotor rises",
        sets=rising(("motor.friction.coulomb",)),
        magnitude=rise("N m", 0.1, 1e6),
    ),
    Fault(
        name="bearing_drags",
        text="viscous friction of the rotor rises",
        sets=rising(("motor.friction.viscous",)),
        magnitude=rise("N m s/rad", 1e-3, 1e6),
    ),
)
