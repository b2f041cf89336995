"""Joints of a URDF, with their frames: its tree as it stands in the XML.

Numbers are collected first, then turned into frames all at once.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.name_rule import check_joint_name
from arm_emulator.base.products import measure_length, multiply_matrices
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.frames import (
    EYE,
    X_AXIS,
    Frame,
    build_rotations,
    compute_cross,
    round_rotation,
)

MOVING_KINDS = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}
FREE_KINDS = ("floating", "planar")  # no joints of an arm, but they may be locked at 0
# Beyond these a number in a URDF is a slip, and what is computed from it may overflow.
LARGEST_LENGTH = 1e6  # m
LARGEST_ANGLE = 1e6  # rad


@dataclass(frozen=True)
class UrdfJoint:
    """A joint of any kind: its frame in the parent link's, its axis in its own."""

    name: str
    kind: str
    parent: str
    child: str
    placement: Frame
    axis: Array

    def place_at(self, position: float) -> Frame:
        """Return the child's frame in the parent's with the joint at `position` [rad or m]."""
        if self.kind == "fixed" or self.kind in FREE_KINDS:
            return self.placement
        if self.kind == "prismatic":
            return self.placement @ Frame(p=position * self.axis)
        a = compute_cross(self.axis)
        sine, versine = math.sin(position), 1.0 - math.cos(position)
        return self.placement @ Frame(np.eye(3) + sine * a + multiply_matrices(versine * a, a))


def list_element_names(robot: ET.Element, tag: str, where: str) -> dict[str, int]:
    """Return the names of the robot's links or joints, with their places."""
    names: dict[str, int] = {}
    for place, element in enumerate(robot.findall(tag)):
        name = element.get("name") or ""
        if not name or name in names:
            raise Refusal(where, f"{tag} name", "be given and unique", repr(name))
        if not name.isprintable():
            raise Refusal(where, f"{tag} name", "have printable letters only", repr(name))
        if tag == "joint":
            check_joint_name(where, "joint name", name)
        names[name] = place
    return names


def read_joints(robot: ET.Element, links: Mapping[str, int], where: str) -> list[UrdfJoint]:
    """Return the joints of a robot, in their order."""
    list_element_names(robot, "joint", where)
    joints = parse_joints(robot.findall("joint"), where)
    for joint in joints:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                rule = "be a link of the URDF"
                raise Refusal(where, f"joint {joint.name}: {role}", rule, repr(link))
    return joints


def parse_joints(elements: list[ET.Element], where: str) -> list[UrdfJoint]:
    """Return what elements <joint> declare."""
    whats = [f"joint {element.get('name')}" for element in elements]
    placements = read_frames([e.find("origin") for e in elements], whats, "origin", where)
    joints = []
    for element, label, placement in zip(elements, whats, placements, strict=True):
        kind = element.get("type") or ""
        if kind not in ("fixed", *MOVING_KINDS, *FREE_KINDS):
            raise Refusal(
                where, f"{label}: type", "be supported", kind or "nothing",
                "revolute, continuous, prismatic, fixed",
            )  # fmt: skip
        axis = (
            X_AXIS if kind == "fixed" else _read_axis(element.find("axis"), f"{label}: axis", where)
        )
        parent, child = element.find("parent"), element.find("child")
        joints.append(
            UrdfJoint(
                name=element.get("name") or "",
                kind=kind,
                parent="" if parent is None else parent.get("link") or "",
                child="" if child is None else child.get("link") or "",
                placement=placement,
                axis=axis,
            )
        )
    return joints


def _read_axis(element: ET.Element | None, label: str, where: str) -> Array:
    if element is None:
        return X_AXIS
    axis = np.array(parse_numbers(element.get("xyz", "1 0 0"), 3, f"{label} xyz", where))
    check_size(axis[None], LARGEST_LENGTH, [label], "xyz", where)
    size = measure_length(axis)
    if size < 1e-6:
        raise Refusal(where, label, "have a direction", tuple(map(float, axis)))
    return axis / size


def read_frames(
    origins: list[ET.Element | None], whats: list[str], name: str, where: str
) -> list[Frame]:
    """Return the frames of elements <origin>; without one, no displacement."""
    rows, no_turn = [], (0.0,) * 6
    for origin, label in zip(origins, whats, strict=True):
        if origin is None:
            rows.append(no_turn)
            continue
        xyz, rpy = origin.get("xyz", "0 0 0"), origin.get("rpy", "0 0 0")
        words = [*xyz.split(), *rpy.split()]
        try:
            x, y, z, roll, pitch, yaw = map(float, words)
        except ValueError:
            words = []
        if len(words) != 6 or len(xyz.split()) != 3:  # name the one at fault
            parse_numbers(xyz, 3, f"{label}: {name} xyz", where)
            parse_numbers(rpy, 3, f"{label}: {name} rpy", where)
        rows.append((x, y, z, roll, pitch, yaw))
    values = np.array(rows).reshape(-1, 6)
    check_size(values[:, :3], LARGEST_LENGTH, whats, f"{name} xyz", where)
    check_size(values[:, 3:], LARGEST_ANGLE, whats, f"{name} rpy", where)
    R = round_rotation(
        multiply_matrices(
            *(build_rotations(axis, values[:, 3 + axis].tolist()) for axis in (2, 1, 0))
        )
    )
    turned = (values[:, 3:] != 0.0).any(axis=1).tolist()
    p = values[:, :3].copy()
    return [Frame(R[k] if turned[k] else EYE, p[k]) for k in range(len(rows))]


def parse_numbers(text: str | None, count: int, label: str, where: str) -> list[float]:
    """Return `count` numbers of an attribute."""
    words = (text or "").split() if count > 1 else [text or ""]
    if len(words) != count:
        raise Refusal(where, label, "be three numbers", repr(text))
    try:
        return [float(word) for word in words]
    except ValueError:
        raise Refusal(where, label, "be a number", repr(text)) from None


def check_size(values: Array, largest: float, whats: list[str], name: str, where: str) -> None:
    """Refuse rows (K, ...) of which an entry is not finite or too large."""
    for row, column in np.argwhere(~(np.abs(values) <= largest)).tolist():
        value = float(values[row, column])
        rule = f"be from {-largest:g} to {largest:g}" if math.isfinite(value) else "be finite"
        raise Refusal(where, f"{whats[row]}: {name}", rule, value)


def find_root(links: Mapping[str, int], joints: list[UrdfJoint], where: str) -> str:
    """Return the only link that no joint moves."""
    parents: dict[str, str] = {}
    for joint in joints:
        if joint.child in parents:
            raise Refusal(
                where,
                f"link {joint.child}",
                "hang on one joint (closed loops need another simulator)",
                f"joints {parents[joint.child]} and {joint.name}",
            )
        parents[joint.child] = joint.name
    roots = [name for name in links if name not in parents]
    if len(roots) != 1:
        rule = "have one base link that no joint moves"
        actual = ", ".join(roots) if roots else "none (a loop)"
        raise Refusal(where, "robot", rule, actual)
    return roots[0]


def list_names(joints: list[UrdfJoint]) -> str:
    """Return the names of joints, for a refusal."""
    return ", ".join(joint.name for joint in joints)
