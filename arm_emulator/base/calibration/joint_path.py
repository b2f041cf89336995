"""The joints of a description from its base to its flange, with what is fixed between them."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.products import apply_matrix, measure_length
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.frames import Frame
from arm_emulator.base.urdf.joint_tree import (
    MOVING_KINDS,
    UrdfJoint,
    find_root,
    list_element_names,
    read_joints,
)

BASE, FLANGE = "base", "tool0"  # names that descriptions of industrial arms share (ROS-Industrial)


@dataclass(frozen=True)
class JointPath:
    """The path from the base's frame to the flange, all joints at 0.

    Attributes:
        joints: moving and fixed ones, from the root link to the flange.
        base: frame in which makers state their numbers, seen from the root link.
        where: the description, for refusals.
    """

    joints: tuple[UrdfJoint, ...]
    base: Frame
    where: str

    @property
    def moving(self) -> tuple[UrdfJoint, ...]:
        """The moving joints."""
        return tuple(joint for joint in self.joints if joint.kind in MOVING_KINDS)

    @property
    def frames(self) -> Mapping[str, Frame]:
        """Frame of each joint's child link, seen from the root link."""
        frame, placed = Frame(), {}
        for joint in self.joints:
            frame = placed[joint.name] = frame @ joint.placement
        return placed

    @property
    def flange(self) -> Frame:
        """Frame of the flange, seen from the root link."""
        return self.frames[self.joints[-1].name]

    @property
    def axes(self) -> list[tuple[Array, Array]]:
        """A point and the direction of each moving joint's axis, seen from the root link."""
        frames = self.frames
        return [(frames[joint.name].p, apply_matrix(frames[joint.name].R, joint.axis))
                for joint in self.moving]  # fmt: skip

    @property
    def behind(self) -> tuple[UrdfJoint, ...]:
        """The fixed joints behind the last moving one."""
        last = max(self.joints.index(joint) for joint in self.moving)
        return self.joints[last + 1 :]


def find_path(robot: ET.Element, where: str, base: str, flange: str, tool: str) -> JointPath:
    """Return the path from base to flange of a description whose locked joints are fixed.

    Args:
        robot: the description.
        where: its name in refusals.
        base: link of the makers' base; empty: `base`, else the root link.
        flange: link up to which they state numbers; empty: `tool0`, else the tool.
        tool: the tool's link.

    Raises:
        Refusal: no such link, or no joint moves the flange.
    """
    links = list_element_names(robot, "link", where)
    joints = read_joints(robot, links, where)
    root = find_root(links, joints, where)
    above = {joint.child: joint for joint in joints}
    base = base or (BASE if BASE in links else root)
    flange = flange or (FLANGE if FLANGE in links else tool)
    for key, link in (("base", base), ("flange", flange)):
        if link not in links:
            rule = "be a link of the URDF"
            raise Refusal(where, f"calibration.{key}", rule, link, ", ".join(links))
    path = _collect_joints(above, flange)
    if not any(joint.kind in MOVING_KINDS for joint in path):
        raise Refusal(where, "calibration.flange", "be moved by a joint", flange)
    frame = Frame()
    for joint in _collect_joints(above, base):
        if joint.kind in MOVING_KINDS:
            raise Refusal(where, "calibration.base", "be fixed to the root link", base)
        frame = frame @ joint.placement
    return JointPath(tuple(path), frame, where)


def _collect_joints(above: Mapping[str, UrdfJoint], link: str) -> list[UrdfJoint]:
    """Return the joints from the root link to a link."""
    path: list[UrdfJoint] = []
    while link in above:
        path.append(above[link])
        link = above[link].parent
    return path[::-1]


def build_axis_frame(axis: Array) -> Array:
    """Return a rotation (3, 3) whose third column is a unit vector."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(helper, axis)
    x = x / measure_length(x)
    return np.column_stack([x, np.cross(axis, x), axis])
