"""Faults, a file each: registered there, known by their `kind`."""

from __future__ import annotations

from arm_emulator.campaign.fault import Fault


def known_faults() -> dict[str, type[Fault]]:
    """Return all kinds by name."""
    from arm_emulator.campaign.faults.registry import FAULT_KINDS

    return dict(sorted(FAULT_KINDS.kinds().items()))
