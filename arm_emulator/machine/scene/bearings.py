"""Bearings that give way, in the description of the machine: joints between a joint and its link.

Only the machine knows them: controllers have the description without.
"""

import copy
import xml.etree.ElementTree as ET

import numpy as np

from arm_emulator.base.urdf.joint_tree import MOVING_KINDS, parse_joints
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.bearing import SECTION, Deflection, name_deflection
from arm_emulator.machine.scene.known_parts import DEFLECTIONS

ACROSS = 1e-9  # cosine of the largest angle that is still a right one
_UNLIMITED = {"lower": "-10000", "upper": "10000", "effort": "0", "velocity": "0"}


def add_bearings(
    robot: ET.Element, joints: Section | None, file: str
) -> tuple[ET.Element, tuple[str, ...]]:
    """Return a description with the deflections of a scene's bearings, and their names.

    Each is a joint that turns with the one before it: first those that shift, then those that tilt.
    The links between them have no body.

    Args:
        robot: the description, which stays as it is.
        joints: that section of the scene.
        file: the description's, for refusals.

    Raises:
        Refusal: a bearing without a direction, or one along the motion of its joint.
    """
    names = (
        []
        if joints is None
        else [name for name in joints.list_keys() if _has_bearing(joints, name)]
    )
    if not names:
        return robot, ()
    robot = copy.deepcopy(robot)
    elements = [e for e in robot.findall("joint") if e.get("name") in names]
    added: list[str] = []
    for element, joint in zip(elements, parse_joints(elements, file), strict=True):
        assert joints is not None
        if joint.kind in MOVING_KINDS:
            slides, axis = joint.kind == "prismatic", joint.axis
            kinds = _read_directions(joints.require_section(joint.name), slides, axis)
            added += _insert_deflections(robot, element, kinds)
    return robot, tuple(added)


def _has_bearing(joints: Section, name: str) -> bool:
    section = joints.get_section(name)
    return section is not None and section.has_key(SECTION)


def _read_directions(
    joint: Section, slides: bool, axis: np.ndarray[tuple[int], np.dtype[np.float64]]
) -> list[type[Deflection]]:
    """Return the directions in which a bearing gives way.

    Args:
        joint: its section.
        slides: whether the joint is prismatic.
        axis: of the joint, in its frame.
    """
    bearing = joint.get_section(SECTION)
    assert bearing is not None
    kinds = [kind for kind in DEFLECTIONS if bearing.has_key(kind.name_direction())]
    if not kinds:
        valid = ", ".join(kind.name_direction() for kind in DEFLECTIONS)
        raise joint.make_refusal(SECTION, "give way in one direction or more", "none", valid)
    for kind in kinds:
        along = abs(float(axis["xyz".index(kind.axis)]))
        if kind.slides == slides and along > ACROSS:
            rule = "be across the axis of its joint, along which the joint itself moves"
            text = " ".join(f"{number:g}" for number in axis)
            raise bearing.make_refusal(
                kind.name_direction(), rule, f"{kind.axis} with the axis {text}"
            )
    return kinds


def _insert_deflections(
    robot: ET.Element, joint: ET.Element, kinds: list[type[Deflection]]
) -> list[str]:
    """Put deflections between a joint and its link; return their names."""
    child = joint.find("child")
    assert child is not None
    names = [name_deflection(str(joint.get("name")), kind) for kind in kinds]
    ends = [*names, str(child.get("link"))]
    child.set("link", ends[0])
    for kind, name, end in zip(kinds, names, ends[1:], strict=True):
        ET.SubElement(robot, "link", name=name)
        of_machine = ET.SubElement(
            robot, "joint", name=name, type="prismatic" if kind.slides else "revolute"
        )
        ET.SubElement(of_machine, "parent", link=name)
        ET.SubElement(of_machine, "child", link=end)
        xyz = " ".join("1" if kind.axis == axis else "0" for axis in "xyz")
        ET.SubElement(of_machine, "axis", xyz=xyz)
        ET.SubElement(of_machine, "limit", _UNLIMITED)
    return names
