"""Faults of the payload."""

from __future__ import annotations

from arm_emulator.machine.parts.fault import Fault, falling, rise, rising, share

FAULTS = (
    Fault(
        "payload_drops",
        "a share of the payload falls off",
        of="",
        sets=falling("payload.mass"),
        magnitude=share(),
    ),
    Fault(
        "payload_heavier",
        "the payload is heavier than known",
        of="",
        sets=rising("payload.mass"),
        magnitude=rise("kg", 1.0, 1e6),
    ),
    Fault(
        "mass_at_joint",
        "a mass is caught at the origin of the link",
        of="links",
        sets=rising("mass"),
        magnitude=rise("kg", 1.0, 1e6),
    ),
)
