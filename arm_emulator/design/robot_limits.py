"""Rates and efforts of joints in a robot description: read, and written where they are guessed."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping

from arm_emulator.design.sizing import Sized

KEYS = ("effort", "velocity")


def read_limits(robot: ET.Element) -> dict[str, dict[str, float | None]]:
    """Return `KEYS` of each joint's limit; None: not given, or no number above 0."""
    limits: dict[str, dict[str, float | None]] = {}
    for joint in robot.findall("joint"):
        limit = joint.find("limit")
        of_joint: dict[str, float | None] = {}
        for key in KEYS:
            try:
                value = float(limit.get(key, "")) if limit is not None else math.nan
            except ValueError:
                value = math.nan
            of_joint[key] = value if 0.0 < value < math.inf else None
        limits[joint.get("name", "")] = of_joint
    return limits


def forget_impossible(robot: ET.Element) -> bool:
    """Make efforts and velocities that are below 0, or no numbers, unknown; whether there were."""
    found = False
    for limit in robot.iter("limit"):
        for key in KEYS:
            try:
                known = float(limit.get(key, "0")) >= 0.0
            except ValueError:
                known = False
            if not known:
                limit.set(key, "0")
                found = True
    return found


def write_limits(robot: ET.Element, drives: Mapping[str, Sized]) -> None:
    """Put a drive's torque, speed and acceleration into the limit of its joint."""
    for joint in robot.findall("joint"):
        drive = drives.get(joint.get("name", ""))
        if drive is None:
            continue
        limit = joint.find("limit")
        if limit is None:
            limit = ET.SubElement(joint, "limit")
        limit.set("effort", f"{drive.peak_torque:.6g}")
        limit.set("velocity", f"{drive.speed:.6g}")
        if limit.get("acceleration") is None:
            limit.set("acceleration", f"{drive.acceleration:.3g}")
