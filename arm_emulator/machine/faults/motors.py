"""Faults of motors and of their drives."""

from arm_emulator.machine.parts.fault import (
    Fault,
    bound_rise,
    bound_share,
    declare_fall,
    declare_rise,
)

_OF_MAGNETS = (
    "motor.torque_constant",
    "motor.torque_per_current",
    "motor.back_emf_constant",
    "motor.flux",
)

FAULTS = (
    Fault(
        "magnets_weaken",
        "the magnets lose a share of their strength",
        sets=declare_fall(*_OF_MAGNETS),
        magnitude=bound_share(0.3),
    ),
    Fault(
        "contact_resistance",
        "a contact between drive and winding has a resistance",
        sets=declare_rise("motor.contact"),
        magnitude=bound_rise("ohm", 1.0, 1e9),
    ),
    Fault(
        "winding_opens",
        "the wires of all phases break: a millionth of the current is left",
        sets=declare_rise("motor.open"),
        magnitude=bound_share(),
    ),
    Fault(
        "turns_short",
        "a share of the winding's turns is shorted",
        sets={
            **declare_fall(*_OF_MAGNETS, "motor.resistance"),
            **dict.fromkeys(
                ("motor.inductance", "motor.inductance_d", "motor.inductance_q"),
                "{x} * (1.0 - {m}) * (1.0 - {m})",
            ),
        },
        magnitude=bound_share(0.3, 0.9),
    ),
    Fault(
        "drive_limit_falls",
        "the drive lowers its limit of current or torque",
        sets=declare_fall("motor.current_limit", "motor.torque_limit"),
        magnitude=bound_share(0.5, 0.999),
    ),
    Fault(
        "current_loop_slows",
        "the loop of current or torque within the drive has less bandwidth",
        sets=declare_fall(
            "motor.bandwidth",
            "motor.current_loop.bandwidth",
            "motor.current_loop.proportional_gain",
            "motor.current_loop.integral_gain",
        ),
        magnitude=bound_share(0.9, 0.999),
    ),
)
