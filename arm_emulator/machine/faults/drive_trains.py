"""Faults of gears, bearings, stops and springs."""

from arm_emulator.machine.parts.fault import (
    Fault,
    bound_rise,
    bound_share,
    declare_fall,
    declare_rise,
)

FAULTS = (
    Fault(
        "gear_breaks",
        "the gear carries only a share of its torque, at 1 none",
        sets=declare_fall("gear.stiffness", "gear.damping", "gear.cubic_stiffness"),
        magnitude=bound_share(),
    ),
    Fault(
        "gear_softens",
        "the gear's stiffness falls",
        sets=declare_fall("gear.stiffness"),
        magnitude=bound_share(0.5, 0.999),
    ),
    Fault(
        "gear_rings",
        "the gear's damping falls",
        sets=declare_fall("gear.damping"),
        magnitude=bound_share(),
    ),
    Fault(
        "friction_steps",
        "dry friction of the link rises",
        sets=declare_rise("friction.coulomb"),
        magnitude=bound_rise("N m", 5.0, 1e6),
    ),
    Fault(
        "grease_thickens",
        "viscous friction of the link rises",
        sets=declare_rise("friction.viscous"),
        magnitude=bound_rise("N m s/rad", 5.0, 1e6),
    ),
    Fault(
        "gear_runs_dry",
        "friction rises with the load on the gear",
        sets=declare_rise("friction.load", "motor.friction.load"),
        magnitude=bound_rise("N m/(N m)", 0.1, 1.0),
    ),
    Fault(
        "bearing_binds",
        "dry friction of the rotor rises",
        sets=declare_rise("motor.friction.coulomb"),
        magnitude=bound_rise("N m", 0.1, 1e6),
    ),
    Fault(
        "bearing_drags",
        "viscous friction of the rotor rises",
        sets=declare_rise("motor.friction.viscous"),
        magnitude=bound_rise("N m s/rad", 1e-3, 1e6),
    ),
)
