"""The tool for which the drives of an arm are sized: its mass, inertia, and offset from the flange.

Makers rate a wrist for a load whose centre lies off the axes: without one the last joint turns
nothing but a flange of some grams. A tool is a cube as dense as water that touches the flange: its
centre is half an edge beyond the flange, and half an edge beside the axis. For 3 to 700 kg that is
0.07 to 0.44 m; 30 makers' allowable moments divided by payload and gravity are 0.07 to 0.28 m.

Without a payload its mass follows from the moving mass M [kg] and the full speed of the last turn
v [rad/s]: 0.9 M^0.86 / v^0.5 kg. This is the fit of 101 arms of 8 makers (0.5 to 800 kg), of which
94 have a payload within a factor of 2.3 of it; the reach adds nothing to these two.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.urdf.frames import Frame
from arm_emulator.design.choose_joints import MIN_ARM
from arm_emulator.machine.chain import Chain

DENSITY = 1000.0  # kg/m3
PAYLOAD, OF_MASS, OF_SPEED = 0.9, 0.86, -0.5
MAX_ARM = 7  # joints that the rule counts from the tool: those before are a rail or a torso
LARGEST_SHARE = 0.5  # of the moving mass: no arm of the sample carries more than 0.4
ALONG = 1e-3  # m: a tool that is nearer to the joint before has no direction


@dataclass(frozen=True)
class RatedTool:
    """A tool at an end of the arm."""

    link: str
    """That carries it."""
    mass: float  # kg
    centre: Array
    """In the link's frame (3,) [m]."""

    @property
    def inertia(self) -> float:
        """About any axis through its centre [kg m2]."""
        return self.mass * _compute_edge(self.mass) ** 2 / 6.0


def list_rated_tools(
    chain: Chain, tool: str, speeds: Mapping[str, float], payload: float | None
) -> list[RatedTool]:
    """Return the tools of an arm, or of a tree of arms.

    The first is at `tool`. Another arm of a tree has one at its last link, by the mass of its own
    branch; a finger, of fewer joints than an arm, has none.

    Args:
        chain: the moving joints and their bodies.
        tool: the tool's link.
        speeds: full speeds of the joints, by name [rad/s or m/s].
        payload: mass of the tool at `tool` [kg]; None: by the rule.
    """
    tools = []
    carriers = {joint.parent for joint in chain.links}
    on_paths = set[int]()
    if tool in chain.carried:
        at, frame = chain.carried[tool]
        path = chain.find_path(at)
        on_paths.update(path)
        mass = _estimate_mass(chain, path, speeds) if payload is None else payload
        tools.append(_place_tool(chain, at, tool, frame, mass))
    for end in range(len(chain.links)):
        branch = [joint for joint in chain.find_path(end) if joint not in on_paths]
        if end in carriers or len(branch) < MIN_ARM:
            continue
        link, frame = list(chain.links[end].links.items())[-1]
        tools.append(_place_tool(chain, end, link, frame, _estimate_mass(chain, branch, speeds)))
    return tools


def add_tools(robot: ET.Element, tools: list[RatedTool]) -> ET.Element:
    """Return a description with tools, each a link that is fixed to the one that carries it."""
    loaded = ET.fromstring(ET.tostring(robot))
    names = {element.get("name") for element in loaded}
    for number, tool in enumerate(tools):
        name = f"rated_tool_{number}"
        while name in names:
            name += "_"
        names.add(name)
        link = ET.SubElement(loaded, "link", name=name)
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "origin", xyz=" ".join(map(repr, tool.centre.tolist())))
        ET.SubElement(inertial, "mass", value=repr(tool.mass))
        moments = dict.fromkeys(("ixx", "iyy", "izz"), repr(tool.inertia))
        ET.SubElement(inertial, "inertia", moments | dict.fromkeys(("ixy", "ixz", "iyz"), "0"))
        joint = ET.SubElement(loaded, "joint", name=name, type="fixed")
        ET.SubElement(joint, "parent", link=tool.link)
        ET.SubElement(joint, "child", link=name)
    return loaded


def _estimate_mass(chain: Chain, path: list[int], speeds: Mapping[str, float]) -> float:
    """Return the payload by the rule [kg]; `path`: the joints that carry it."""
    path = path[-MAX_ARM:]
    moving = sum(chain.links[joint].body.mass for joint in path)
    revolute = [chain.links[joint].name for joint in path if chain.links[joint].kind == "revolute"]
    speed = speeds.get(revolute[-1], math.pi) if revolute else math.pi
    payload = PAYLOAD * moving**OF_MASS * speed**OF_SPEED
    return float(min(payload, LARGEST_SHARE * moving))


def _compute_edge(mass: float) -> float:
    return float((mass / DENSITY) ** (1.0 / 3.0))


def _place_tool(chain: Chain, at: int, link: str, frame: Frame, mass: float) -> RatedTool:
    """Return a tool at a link, whose frame in that of its joint's child is given."""
    joint = chain.links[at]
    axis = joint.axes[2]  # of the joint, in the child's frame
    along = float(axis @ frame.p)
    across = frame.p - along * axis
    if abs(along) < ALONG:
        along = float(joint.R[:, 2] @ joint.p)  # from the joint before
    if math.hypot(*across) > abs(along):  # the last joint bends the arm
        outward = across / math.hypot(*across)
        aside = axis
    else:
        outward = -axis if along < 0.0 else axis
        helper = np.eye(3)[int(np.argmin(np.abs(outward)))]
        aside = np.cross(outward, helper)
        aside /= math.hypot(*aside)
    half = 0.5 * _compute_edge(mass)
    return RatedTool(link, mass, frame.R.T @ (half * (outward + aside)))
