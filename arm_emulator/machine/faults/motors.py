"""Faults of motors and of their drives."""

from __future__ import annotations

from arm_emulator.machine.parts.fault import Fault, falling, rise, rising, share

FAULTS = (
    Fault(
        "magnets_weaken",
        "the magnets lose a share of their strength",
        sets=falling("motor.torque_constant", "motor.back_emf_constant", "motor.flux"),
        magnitude=share(0.3),
    ),
    Fault(
        "contact_resistance",
        "a contact between drive and winding has a resistance",
        sets=rising("motor.resistance"),
        magnitude=rise("ohm", 1.0, 1e9),
    ),
    Fault(
        "winding_opens",
        "a wire of the winding breaks: its resistance is 1e4 times as large",
        sets={"motor.resistance": "{x} * (1.0 + 1e4 * {m})"},
        magnitude=share(),
    ),
    Fault(
        "turns_short",
        "a share of the winding's turns is shorted",
        sets={
            **falling("motor.torque_constant", "motor.back_emf_constant", "motor.flux"),
            **falling("motor.resistance"),
            **dict.fromkeys(
                ("motor.inductance", "motor.inductance_d", "motor.inductance_q"),
                "{x} * (1.0 - {m}) * (1.0 - {m})",
            ),
        },
        magnitude=share(0.3, 0.9),
    ),
    Fault(
        "drive_limit_falls",
        "the drive lowers its limit of current or torque",
        sets=falling("motor.current_limit", "motor.torque_limit"),
        magnitude=share(0.5, 0.999),
    ),
    Fault(
        "current_loop_slows",
        "the loop of current or torque within the drive has less bandwidth",
        sets=falling("motor.bandwidth"),
        magnitude=share(0.9, 0.999),
    ),
)
