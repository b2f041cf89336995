"""From a robot description to Pinocchio's model, with only what kinematics need.

Shapes, masses and transmissions are left out: they need not even be readable. Fixed links cost
nothing, however many they are. Limits of speed, acceleration and effort are read here, since
readers of a URDF drop them with a joint that has no limits of position.
"""

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import pinocchio as pin

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.urdf_text import complete_limits, parse_urdf

# Before the names in the model: a joint and a link may be called the same, and a joint "universe".
JOINT, LINK = "joint ", "link "
MAX_MOVING = 128  # joints; for 400 Pinocchio takes 20 s to set up its data
MAX_DEPTH = 1000  # joints; Pinocchio goes down a chain by recursion

NO_EFFORT = 1e9  # N m or N: such a limit limits nothing

WHERE = "robot_description"


def build_full_model(urdf_xml: str, tool: str = "", masses: bool = False) -> Any:
    """Return the model of all moving joints, with the frame of `tool` (a link or a fixed joint).

    With `masses` it has those of all links, too.

    Raises:
        Refusal: not a robot description, or one that Pinocchio does not take.
    """
    return _build_model(urdf_xml, tool, masses).copy()


@lru_cache(maxsize=8)  # kinematics and torques of one arm begin with the same models
def _build_model(urdf_xml: str, tool: str, masses: bool) -> Any:
    robot = parse_urdf(urdf_xml, WHERE)
    complete_limits(robot, WHERE)
    joints = robot.findall("joint") if masses else _select_needed(robot.findall("joint"), tool)
    _check_depth(joints)
    moving = sum(joint.get("type") != "fixed" for joint in joints)
    if moving > MAX_MOVING:
        raise Refusal(WHERE, "the robot", f"have at most {MAX_MOVING} moving joints", moving)
    bare = ET.Element("robot", name="robot")
    dropped = {_read_link(j, "child") for j in robot.findall("joint")} - {
        _read_link(j, "child") for j in joints
    }
    for link in robot.findall("link"):
        if link.get("name") not in dropped:
            bare_link = ET.SubElement(bare, "link", name=LINK + link.get("name", ""))
            bare_link.extend(link.findall("inertial") if masses else ())
    bare.extend(map(_strip_joint, joints))
    try:
        return pin.buildModelFromXML(ET.tostring(bare, encoding="unicode"))
    except (ValueError, RuntimeError, IndexError) as error:
        raise Refusal(WHERE, "the text", "be a URDF", error) from error


@dataclass(frozen=True)
class RateLimits:
    """Limits of a joint's speed and torque; infinite if the description has none."""

    velocity: float
    """[rad/s or m/s]"""
    acceleration: float
    """[rad/s2 or m/s2]"""
    effort: float
    """[N m or N]"""


def read_rate_limits(urdf_xml: str) -> dict[str, RateLimits]:
    """Return the limits of a robot description's joints by their names.

    They are the attributes `velocity`, `acceleration` and `effort` of <limit>; 0 is how
    descriptions leave one open.

    Raises:
        Refusal: not a robot description, or a limit that is no number or below 0.
    """
    limits = {}
    for joint in parse_urdf(urdf_xml, WHERE).findall("joint"):
        if joint.get("type") == "fixed":
            continue
        limits[joint.get("name", "")] = RateLimits(
            _read_rate_limit(joint, "velocity"),
            _read_rate_limit(joint, "acceleration"),
            _read_effort(joint),
        )
    return limits


def _read_effort(joint: ET.Element) -> float:
    """Return the largest torque; infinite unless a number > 0 is given."""
    limit = joint.find("limit")
    try:
        value = float("0" if limit is None else limit.get("effort", "0"))
    except ValueError:
        return math.inf
    return value if 0.0 < value < NO_EFFORT else math.inf


def _read_rate_limit(joint: ET.Element, key: str) -> float:
    limit = joint.find("limit")
    text = None if limit is None else limit.get(key)
    try:
        value = float(text or "0")
    except ValueError:
        value = math.nan
    if not value >= 0.0:
        quantity = f"joint {joint.get('name')}: limit {key}"
        raise Refusal(WHERE, quantity, "be a number >= 0", repr(text))
    return value or math.inf


def list_links(model: Any) -> list[str]:
    """Return the names of the model's links, the base first."""
    bodies = (str(frame.name) for frame in model.frames if frame.type == pin.FrameType.BODY)
    return [name.removeprefix(LINK) for name in bodies]


def _read_link(joint: ET.Element, tag: str) -> str:
    element = joint.find(tag)
    return "" if element is None else element.get("link", "")


def _select_needed(joints: list[ET.Element], tool: str) -> list[ET.Element]:
    """Return the joints without fixed ones that carry neither moving joints nor the tool."""
    above = {_read_link(joint, "child"): joint for joint in joints}
    children: dict[str, int] = {}
    for joint in joints:
        children[_read_link(joint, "parent")] = children.get(_read_link(joint, "parent"), 0) + 1
    ends = [link for link in above if link not in children]
    dropped = set()
    while ends:
        link = ends.pop()
        joint = above[link]
        if joint.get("type") != "fixed" or tool in (link, joint.get("name")):
            continue
        dropped.add(joint)
        parent = _read_link(joint, "parent")
        children[parent] -= 1
        if not children[parent] and parent in above:
            ends.append(parent)
    return [joint for joint in joints if joint not in dropped]


def _check_depth(joints: list[ET.Element]) -> None:
    parents = {_read_link(joint, "child"): _read_link(joint, "parent") for joint in joints}
    depths: dict[str, int] = {}
    for link in parents:
        row: list[str] = []
        at = link
        while at in parents and at not in depths and len(row) <= MAX_DEPTH:
            row.append(at)
            at = parents[at]
        for depth, link_below in enumerate(reversed(row), start=depths.get(at, 0) + 1):
            depths[link_below] = depth
        if row and depths[row[0]] > MAX_DEPTH:
            rule = f"have at most {MAX_DEPTH} joints in a row, and no loop"
            raise Refusal(WHERE, "the robot", rule, "more")


def _strip_joint(joint: ET.Element) -> ET.Element:
    kind = joint.get("type", "")
    bare = ET.Element("joint", name=JOINT + joint.get("name", ""), type=kind)
    for tag in ("parent", "child"):
        ET.SubElement(bare, tag, link=LINK + _read_link(joint, tag))
    bare.extend(element for element in joint if element.tag in ("origin", "axis"))
    limit = joint.find("limit")
    if limit is not None and kind in ("revolute", "prismatic"):
        bounds = {key: limit.get(key, "0") for key in ("lower", "upper")}
        ET.SubElement(bare, "limit", {**bounds, "effort": "0", "velocity": "0"})
    return bare
