"""The serial chain of a URDF: links with everything fixed to them, in frames made for the core."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from arm_emulator.refusal import Refusal

Array = NDArray[np.float64]

MOVING_KINDS = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}


@dataclass(frozen=True)
class Frame:
    """A frame seen from another: rotation `R` (3, 3) and origin `p` (3,) [m]."""

    R: Array = field(default_factory=lambda: np.eye(3))
    p: Array = field(default_factory=lambda: np.zeros(3))

    def __matmul__(self, other: Frame) -> Frame:
        return Frame(_clean(self.R @ other.R), self.R @ other.p + self.p)


@dataclass(frozen=True)
class Body:
    """Inertia about an origin: mass [kg], first moment [kg m] (3,), tensor [kg m2] (3, 3)."""

    mass: float = 0.0
    moment: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))

    @classmethod
    def from_center(cls, mass: float, com: Array, inertia: Array) -> Body:
        """Return the body of `mass` whose `inertia` is given about its centre of mass `com`."""
        return cls(mass, mass * com, inertia - mass * _cross(com) @ _cross(com))

    def __add__(self, other: Body) -> Body:
        return Body(
            self.mass + other.mass, self.moment + other.moment, self.inertia + other.inertia
        )

    def seen_from(self, frame: Frame) -> Body:
        """Return this body in the frame from which its own is seen as `frame`."""
        R, p = frame.R, frame.p
        h = R @ self.moment
        shift = _cross(p) @ _cross(h) + _cross(h) @ _cross(p) + self.mass * _cross(p) @ _cross(p)
        return Body(self.mass, h + self.mass * p, R @ self.inertia @ R.T - shift)


@dataclass(frozen=True)
class ChainJoint:
    """A moving joint and its link, in the frames of `core/scene.hpp`.

    The link's frame has its origin on the joint axis and z along it; the turn from the parent's
    frame is Rx(alpha) Rz(q + theta_0), and `p` (3,) [m] is its origin in the parent's frame.
    """

    name: str
    kind: str
    cos_alpha: float
    sin_alpha: float
    theta_0: float
    p: Array
    body: Body


@dataclass(frozen=True)
class Chain:
    """The moving joints from base to tip, and the base's frame.

    `R_BW` (3, 3) turns world vectors (gravity) into the base's frame, from which the first joint is
    seen; both have their origin at the URDF's root link.
    """

    joints: tuple[ChainJoint, ...]
    R_BW: Array


@dataclass(frozen=True)
class _UrdfJoint:
    name: str
    kind: str
    parent: str
    child: str
    placement: Frame
    axis: Array
    mimic: bool


def read_chain(
    urdf: str,
    where: str,
    *,
    locked: Mapping[str, float],
    tool: str,
    payload: Body | None = None,
) -> Chain:
    """Read the chain of moving joints from a URDF text, fixed and locked joints merged.

    Args:
        urdf: the URDF's XML text.
        where: what to call it in refusals.
        locked: joints held at a position [rad or m].
        tool: the link that carries `payload`, which is given in that link's frame.
        payload: a body to add at the tool.

    Raises:
        Refusal: the text is no URDF, or its machine is no serial chain with sound inertias.
    """
    bodies, joints = _parse(urdf, where)
    for name in locked:
        if name not in {joint.name for joint in joints}:
            raise Refusal(where, f"locked.{name}", "be a joint of the URDF", name, _names(joints))
    for joint in joints:
        if joint.mimic and joint.name not in locked:
            raise Refusal(
                where,
                f"joint {joint.name}",
                "move on its own",
                "a mimic joint",
                "lock it in the scene: locked: {" + joint.name + ": 0.0}",
            )
    if tool not in bodies:
        raise Refusal(where, "tool", "be a link of the URDF", tool, ", ".join(bodies))
    if payload is not None:
        bodies[tool] = bodies[tool] + payload
    root = _root(bodies, joints, where)
    return _assemble(_moving_joints(root, bodies, joints, locked, where), where)


def lock_joints(urdf: str, locked: Mapping[str, float]) -> str:
    """Return the URDF text with the `locked` joints made fixed at their positions."""
    if not locked:
        return urdf
    robot = ET.fromstring(urdf)
    for element in robot.iter("joint"):
        name = element.get("name") or ""
        if name not in locked:
            continue
        joint = _read_joint(element, "")
        held = _moved(joint, locked[name])
        for tag in ("origin", "axis", "limit", "mimic", "dynamics", "safety_controller"):
            for old in element.findall(tag):
                element.remove(old)
        element.set("type", "fixed")
        xyz, rpy = (" ".join(map(repr, map(float, a))) for a in (held.p, _rpy(held.R)))
        ET.SubElement(element, "origin", xyz=xyz, rpy=rpy)
    return ET.tostring(robot, encoding="unicode")


# Reading the XML


def _parse(urdf: str, where: str) -> tuple[dict[str, Body], list[_UrdfJoint]]:
    try:
        robot = ET.fromstring(urdf)
    except ET.ParseError as error:
        raise Refusal(where, "file", "be well-formed XML", error) from None
    if robot.tag != "robot":
        raise Refusal(where, "root element", "be <robot>", f"<{robot.tag}>")
    bodies: dict[str, Body] = {}
    for element in robot.findall("link"):
        name = element.get("name") or ""
        if not name or name in bodies:
            raise Refusal(where, "link name", "be given and unique", repr(name))
        bodies[name] = _read_body(element, f"link {name}", where)
    joints: list[_UrdfJoint] = []
    for element in robot.findall("joint"):
        joint = _read_joint(element, where)
        if not joint.name or joint.name in {other.name for other in joints}:
            raise Refusal(where, "joint name", "be given and unique", repr(joint.name))
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in bodies:
                raise Refusal(
                    where, f"joint {joint.name}: {role}", "be a link of the URDF", repr(link)
                )
        joints.append(joint)
    return bodies, joints


def _read_joint(element: ET.Element, where: str) -> _UrdfJoint:
    name = element.get("name") or ""
    kind = element.get("type") or ""
    what = f"joint {name}"
    if kind != "fixed" and kind not in MOVING_KINDS:
        raise Refusal(
            where, f"{what}: type", "be one the emulator knows", kind or "nothing",
            "revolute, continuous, prismatic, fixed",
        )  # fmt: skip
    axis = _triple(element.find("axis"), "xyz", (1.0, 0.0, 0.0), f"{what}: axis", where)
    length = float(np.linalg.norm(axis))
    if kind != "fixed" and length < 1e-6:
        raise Refusal(where, f"{what}: axis", "have a direction", tuple(map(float, axis)))
    links = []
    for role in ("parent", "child"):
        found = element.find(role)
        links.append("" if found is None else found.get("link") or "")
    return _UrdfJoint(
        name=name,
        kind=kind,
        parent=links[0],
        child=links[1],
        placement=_read_origin(element.find("origin"), f"{what}: origin", where),
        axis=axis / length if length > 0.0 else axis,
        mimic=element.find("mimic") is not None,
    )


def _read_body(link: ET.Element, what: str, where: str) -> Body:
    inertial = link.find("inertial")
    if inertial is None:
        return Body()
    mass_element, tensor_element = inertial.find("mass"), inertial.find("inertia")
    if mass_element is None or tensor_element is None:
        raise Refusal(where, f"{what}: inertial", "hold <mass> and <inertia>", "only a part")
    mass = _number(mass_element.get("value"), f"{what}: mass", where)
    if mass < 0.0:
        raise Refusal(where, f"{what}: mass", "be >= 0 kg", mass)
    xx, yy, zz, xy, xz, yz = (
        _number(tensor_element.get(key), f"{what}: {key}", where)
        for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    )
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if mass == 0.0 and not inertia.any():
        return Body()  # a mere frame, as published descriptions write it
    check_inertia(inertia, f"{what}: inertia", where)
    frame = _read_origin(inertial.find("origin"), f"{what}: inertial origin", where)
    return Body.from_center(mass, frame.p, frame.R @ inertia @ frame.R.T)


def check_inertia(inertia: Array, what: str, where: str) -> None:
    """Refuse a tensor (3, 3) [kg m2] about the centre of mass that is not positive definite."""
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] <= 1e-12 * moments[2]:
        shown = ", ".join(f"{moment:.3g}" for moment in moments)
        raise Refusal(
            where, what, "be positive definite, principal moments > 0 kg m2", f"({shown})"
        )


def _read_origin(element: ET.Element | None, what: str, where: str) -> Frame:
    zero = (0.0, 0.0, 0.0)
    p = _triple(element, "xyz", zero, what, where)
    roll, pitch, yaw = _triple(element, "rpy", zero, what, where)
    return Frame(_clean(_turn(2, yaw) @ _turn(1, pitch) @ _turn(0, roll)), p)


def _triple(
    element: ET.Element | None,
    key: str,
    default: tuple[float, float, float],
    what: str,
    where: str,
) -> Array:
    text = None if element is None else element.get(key)
    if text is None:
        return np.array(default)
    words = text.split()
    if len(words) != 3:
        raise Refusal(where, f"{what} {key}", "be three numbers", repr(text))
    return np.array([_number(word, f"{what} {key}", where) for word in words])


def _number(text: str | None, what: str, where: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        raise Refusal(where, what, "be a number", repr(text)) from None
    if not math.isfinite(value):
        raise Refusal(where, what, "be finite", text)
    return value


# From the tree to the chain


def _root(bodies: Mapping[str, Body], joints: list[_UrdfJoint], where: str) -> str:
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
    roots = [name for name in bodies if name not in parents]
    if len(roots) != 1:
        rule = "have one base link that no joint moves"
        got = ", ".join(roots) if roots else "none (a loop)"
        raise Refusal(where, "robot", rule, got)
    return roots[0]


@dataclass
class _Moving:
    """A moving joint, its placement in the frame of the last moving link, and its merged body."""

    joint: _UrdfJoint
    placement: Frame
    body: Body


def _moving_joints(
    root: str,
    bodies: Mapping[str, Body],
    joints: list[_UrdfJoint],
    locked: Mapping[str, float],
    where: str,
) -> list[_Moving]:
    moving: list[_Moving] = []
    reached = {root}
    branch = [(root, Frame(), -1)]  # link, its frame in the carrying link's, the carrier's index
    while branch:
        link, frame, carrier = branch.pop()
        for joint in (j for j in joints if j.parent == link):
            reached.add(joint.child)
            if joint.kind == "fixed" or joint.name in locked:
                at = frame @ _moved(joint, locked.get(joint.name, 0.0))
                if carrier >= 0:
                    moving[carrier].body += bodies[joint.child].seen_from(at)
                branch.append((joint.child, at, carrier))
                continue
            if carrier != len(moving) - 1:
                raise Refusal(
                    where,
                    f"joint {joint.name}",
                    "follow the chain (the emulator moves serial arms)",
                    f"a branch beside joint {moving[carrier + 1].joint.name}",
                    "lock one of the branches in the scene",
                )
            moving.append(_Moving(joint, frame @ joint.placement, bodies[joint.child]))
            branch.append((joint.child, Frame(), len(moving) - 1))
    lost = [name for name in bodies if name not in reached]
    if lost:
        raise Refusal(where, f"link {lost[0]}", "hang on the base (it is in a loop)", lost[0])
    if not moving:
        raise Refusal(where, "robot", "have a moving joint", "none")
    return moving


def _moved(joint: _UrdfJoint, position: float) -> Frame:
    """Return the child's frame in the parent's with the joint at `position`."""
    if joint.kind == "fixed":
        return joint.placement
    if joint.kind == "prismatic":
        return joint.placement @ Frame(p=position * joint.axis)
    a = _cross(joint.axis)
    return joint.placement @ Frame(
        np.eye(3) + math.sin(position) * a + (1.0 - math.cos(position)) * a @ a
    )


def _assemble(moving: list[_Moving], where: str) -> Chain:
    """Choose each link's frame: z along its joint, x so that the next joint's tilt is about x.

    With z fixed, one free turn gamma about z is left per link. It is spent so that the next axis,
    seen from this link, lies in the plane x = 0: then the turn to the next link is Rx(alpha) and
    nothing else, as in the convention of Denavit, Hartenberg and Khalil.
    """
    for one in moving:
        if one.body.mass <= 0.0:
            raise Refusal(
                where, f"mass moved by joint {one.joint.name}", "be > 0 kg", one.body.mass
            )
    # E: rotation of each link's core frame in its URDF frame, at gamma = 0.
    E = [_frame_with_z(one.joint.axis) for one in moving]
    gammas: list[float] = []
    for here, one in zip(E, moving[1:], strict=False):
        z_next = _clean(here.T @ one.placement.R @ one.joint.axis)
        gammas.append(_exact_atan2(float(z_next[0]), -float(z_next[1])))
    gammas.append(0.0)
    turned = [_clean(e @ _turn(2, gamma)) for e, gamma in zip(E, gammas, strict=True)]
    R_WB = _clean(moving[0].placement.R @ E[0])
    joints = []
    for index, one in enumerate(moving):
        if index == 0:
            # The base's turn is free: with z along the first joint, that joint needs no tilt.
            R, p = _turn(2, gammas[0]), R_WB.T @ one.placement.p
        else:
            before = turned[index - 1]
            R = _clean(before.T @ one.placement.R @ turned[index])
            p = before.T @ one.placement.p
        # R = Rx(alpha) Rz(theta_0): its third column is (0, -sin alpha, cos alpha), its first row
        # (cos theta_0, -sin theta_0, 0).
        joints.append(
            ChainJoint(
                name=one.joint.name,
                kind=MOVING_KINDS[one.joint.kind],
                cos_alpha=float(R[2, 2]),
                sin_alpha=float(-R[1, 2]),
                theta_0=_exact_atan2(-float(R[0, 1]), float(R[0, 0])),
                p=p,
                body=one.body.seen_from(Frame(turned[index].T)),
            )
        )
    return Chain(tuple(joints), R_WB.T)


def _frame_with_z(axis: Array) -> Array:
    """Return a rotation whose third column is `axis`, made of zeros and ones where possible."""
    z = axis
    helper = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = helper - (helper @ z) * z
    x = x / np.linalg.norm(x)
    return _clean(np.column_stack([x, np.cross(z, x), z]))


def _exact_atan2(y: float, x: float) -> float:
    return 0.0 if y == 0.0 and x == 0.0 else math.atan2(y, x) + 0.0


def _turn(axis: int, angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    R = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return _clean(R)


def _rpy(R: Array) -> Array:
    """Return roll, pitch and yaw of Rz(yaw) Ry(pitch) Rx(roll)."""
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    if math.hypot(R[0, 0], R[1, 0]) < 1e-12:
        return np.array([0.0, pitch, math.atan2(-R[0, 1], R[1, 1])])
    return np.array([math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])])


def _clean(R: Array) -> Array:
    """Return a rotation with entries that rounding moved off 0 and +-1 put back.

    Zeros are what the compiler folds; the threshold is a few units of the last place.
    """
    nearest = np.round(R)
    return np.where(np.abs(R - nearest) < 1e-15, nearest, R) + 0.0


def _cross(a: Array) -> Array:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def _names(joints: list[_UrdfJoint]) -> str:
    return ", ".join(joint.name for joint in joints)
