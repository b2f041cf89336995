"""Numbers of a scene's drives for the motion controller's feed-forward."""

from __future__ import annotations

from collections.abc import Iterable

from arm_emulator.base.number import numbers_of
from arm_emulator.machine.joint import Joint
from arm_emulator.motion.drive_numbers import DriveNumbers


def known_drives(joints: Iterable[Joint]) -> dict[str, DriveNumbers]:
    """Return the data sheet of each joint's gear and friction, by names."""
    return {joint.name: _known_drive(joint) for joint in joints}


def _known_drive(joint: Joint) -> DriveNumbers:
    gear, values = joint.gear, dict[str, float]()
    known = numbers_of(DriveNumbers)
    if gear.stiffness is not None:
        values |= {key: getattr(gear, key) for key in gear.numbers() if key in known}
    for law, prefix, per in (
        (joint.friction, "", 1.0),
        (joint.rotor_friction, "rotor_", abs(gear.ratio)),
    ):
        if law is not None:
            values[f"{prefix}viscous"] = getattr(law, "viscous", 0.0) / per**2
            values[f"{prefix}coulomb"] = getattr(law, "coulomb", 0.0) / per
    return DriveNumbers(**values)
