"""Faults of the payload."""

from arm_emulator.machine.parts.fault import (
    Fault,
    bound_rise,
    bound_share,
    declare_fall,
    declare_rise,
)

FAULTS = (
    Fault(
        "payload_drops",
        "a share of the payload falls off",
        of="",
        sets=declare_fall("payload.mass"),
        magnitude=bound_share(),
    ),
    Fault(
        "payload_heavier",
        "the payload is heavier than known",
        of="",
        sets=declare_rise("payload.mass"),
        magnitude=bound_rise("kg", 1.0, 1e6),
    ),
    Fault(
        "mass_at_joint",
        "a mass is caught at the origin of the link",
        of="links",
        sets=declare_rise("mass"),
        magnitude=bound_rise("kg", 1.0, 1e6),
    ),
)
