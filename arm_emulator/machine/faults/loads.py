"""Faults of the payload."""

from __future__ import annotations

from arm_emulator.machine.parts.fault import Fault, falling, rise, rising, share

FAULTS = (
    Fault(
        name="payload_drops",
        of="",
        text="a share of the payload falls off",
        sets=falling(("payload.mass",)),
        magnitude=share(),
    ),
    Fault(
        name="payload_heavier",
        of="",
        text="the payload is heavier than known",
        sets=rising(("payload.mass",)),
        magnitude=rise("kg", 1.0, 1e6),
    ),
    Fault(
        name="mass_at_joint",
        of="links",
        text="a mass is caught at the origin of the link",
        sets=rising(("mass",)),
        magnitude=rise("kg", 1.0, 1e6),
    ),
)
