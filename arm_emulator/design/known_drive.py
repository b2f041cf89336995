"""Numbers of a scene's drives for the motion controller's feed-forward."""

from __future__ import annotations

from collections.abc import Iterable

from arm_emulator.machine.joint import Joint
from arm_emulator.machine.parts.elastic_gear import ElasticGear
from arm_emulator.machine.parts.progressive_gear import ProgressiveGear
from arm_emulator.motion.drive_numbers import DriveNumbers


def known_drives(joints: Iterable[Joint]) -> dict[str, DriveNumbers]:
    """Return the data sheet of each joint's gear and friction, by names."""
    return {joint.name: _known_drive(joint) for joint in joints}


def _known_drive(joint: Joint) -> DriveNumbers:
    gear, values = joint.gear, dict[str, float]()
    if isinstance(gear, ElasticGear):
        values |= {"stiffness": gear.stiffness, "damping": gear.damping}
    if isinstance(gear, ProgressiveGear):
        values["cubic_stiffness"] = gear.cubic_stiffness
    for law, prefix, per in (
        (joint.friction, "", 1.0),
        (joint.rotor_friction, "rotor_", abs(gear.ratio)),
    ):
        if law is not None:
            values[f"{prefix}viscous"] = getattr(law, "viscous", 0.0) / per**2
            values[f"{prefix}coulomb"] = getattr(law, "coulomb", 0.0) / per
    return DriveNumbers(**values)
