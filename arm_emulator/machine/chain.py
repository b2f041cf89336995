"""The serial chain of a URDF: links with everything fixed to them, in frames made for the core."""

from __future__ import annotations

import dataclasses
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from arm_emulator.base.couplings import Coupling, coupling_of, followers
from arm_emulator.base.quick_dataclass import dataclass
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf_text import complete_limits

Array = NDArray[np.float64]

MOVING_KINDS = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}
FREE_KINDS = ("floating", "planar")  # no joints of an arm, but they may be locked at 0

MOST_JOINTS = 200  # more are no arm, and would compile for hours
# Beyond these a number in a URDF is a slip, and what is computed from it may overflow.
LARGEST_MASS = 1e9  # kg
LARGEST_LENGTH = 1e6  # m
LARGEST_INERTIA = 1e15  # kg m2
LARGEST_ANGLE = 1e6  # rad
# Below these, moved by a joint, what is divided by them may overflow.
SMALLEST_MASS = 1e-12  # kg
SMALLEST_INERTIA = 1e-24  # kg m2


def _constant(values: object) -> Array:
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


_ZERO = _constant(np.zeros(3))
_X = _constant([1.0, 0.0, 0.0])
_EYE = _constant(np.eye(3))  # recognised, so that the many frames without a turn cost little


@dataclass(frozen=True)
class Frame:
    """A frame seen from another: rotation `R` (3, 3) and origin `p` (3,) [m]."""

    R: Array = field(default_factory=lambda: _EYE)
    p: Array = field(default_factory=lambda: _ZERO)

    def __matmul__(self, other: Frame) -> Frame:
        R = self.R if other.R is _EYE else _clean(self.R @ other.R)
        return Frame(R, self.R @ other.p + self.p)


@dataclass(frozen=True)
class Body:
    """Inertia about an origin: mass [kg], first moment [kg m] (3,), tensor [kg m2] (3, 3)."""

    mass: float = 0.0
    moment: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))

    @classmethod
    def from_center(cls, mass: float, com: Array, inertia: Array) -> Body:
        """Return the body of `mass` whose `inertia` is given about its centre of mass `com`."""
        return Bodies.from_center(np.array([mass]), com[None], inertia[None]).one(0)

    def __add__(self, other: Body) -> Body:
        return Body(
            self.mass + other.mass, self.moment + other.moment, self.inertia + other.inertia
        )

    def scaled(self, factor: float) -> Body:
        """Return a body of that many times this one."""
        return Body(factor * self.mass, factor * self.moment, factor * self.inertia)

    def seen_from(self, frame: Frame) -> Body:
        """Return this body in the frame from which its own is seen as `frame`."""
        mass, moment = np.array([self.mass]), self.moment[None]
        alone = Bodies(mass, moment, self.inertia[None])
        return alone.seen_from(frame.R[None], frame.p[None]).one(0)


@dataclass(frozen=True)
class Bodies:
    """Many bodies (K of them) side by side, since a URDF may have thousands of links."""

    mass: Array
    moment: Array
    inertia: Array

    @classmethod
    def from_center(cls, mass: Array, com: Array, inertia: Array) -> Bodies:
        """Return the bodies whose `inertia` (K, 3, 3) is given about their `com` (K, 3)."""
        c, m = _cross(com), mass[:, None, None]
        return cls(mass, mass[:, None] * com, inertia - m * c @ c)

    def seen_from(self, R: Array, p: Array) -> Bodies:
        """Return them in frames from which their own are seen as R (K, 3, 3), p (K, 3)."""
        h = (R @ self.moment[:, :, None])[:, :, 0]
        p_x, h_x = _cross(p), _cross(h)
        shift = p_x @ h_x + h_x @ p_x + self.mass[:, None, None] * p_x @ p_x
        inertia = R @ self.inertia @ R.transpose(0, 2, 1) - shift
        return Bodies(self.mass, h + self.mass[:, None] * p, inertia)

    def one(self, index: int) -> Body:
        """Return one of them."""
        return Body(float(self.mass[index]), self.moment[index], self.inertia[index])

    def some(self, indices: list[int]) -> Bodies:
        """Return those at `indices`."""
        return Bodies(self.mass[indices], self.moment[indices], self.inertia[indices])

    def sum(self) -> Body:
        """Return all of them as one, added one after the other."""
        return Body(
            float(self.mass.cumsum()[-1]),
            self.moment.cumsum(axis=0)[-1],
            self.inertia.cumsum(axis=0)[-1],
        )


@dataclass(frozen=True)
class ChainJoint:
    """A moving joint and its link, in the frames of `core/mechanics/scene.hpp`.

    The link's frame has its origin on the joint axis and z along it; the turn from the parent's
    frame is Rx(alpha) Rz(q + theta_0), and `p` (3,) [m] is its origin in the parent's frame.

    The joint's child in the URDF has the same origin; `axes` (3, 3) turns vectors of the child's
    frame into this one's. `links` has the child, with all that is fixed to it, as frames seen from
    the child.
    """

    name: str
    kind: str
    cos_alpha: float
    sin_alpha: float
    theta_0: float
    p: Array
    body: Body
    axes: Array
    links: Mapping[str, Frame]

    @property
    def link(self) -> str:
        """Name of the joint's child in the URDF."""
        return next(iter(self.links))


@dataclass(frozen=True)
class Chain:
    """The moving joints from base to tip, and the base's frame.

    `links` has all of them; `joints` those by whose names the drives' shafts go, which is all where
    each joint has a drive of its own. `coupling` is how the links' joints go with the shafts.

    `R_BW` (3, 3) turns world vectors (gravity) into the base's frame, from which the first joint is
    seen; both have their origin at the URDF's root link. `carried` has the URDF's links that move,
    each with the joint that carries it and its frame in that of the joint's child link, which
    `R_core` (N, 3, 3) turns into the core's.
    """

    links: tuple[ChainJoint, ...]
    coupling: Coupling
    R_BW: Array
    R_core: Array
    carried: Mapping[str, tuple[int, Frame]]

    @property
    def joints(self) -> tuple[ChainJoint, ...]:
        """Those of the shafts."""
        return tuple(self.links[k] for k in self.link_of)

    @property
    def link_of(self) -> tuple[int, ...]:
        """Place among the links of each shaft's joint."""
        names = [link.name for link in self.links]
        return tuple(map(names.index, self.coupling.shafts))

    def place_of(self, link: str) -> tuple[int, Frame]:
        """Return the joint that carries a link of `carried`, and the frame in the core's of it."""
        joint, frame = self.carried[link]
        return joint, Frame(self.R_core[joint]) @ frame


@dataclass(frozen=True)
class _UrdfJoint:
    name: str
    kind: str
    parent: str
    child: str
    placement: Frame
    axis: Array


def read_chain(
    robot: ET.Element,
    where: str,
    asks: str,
    *,
    locked: Mapping[str, float],
    tool: str,
    payload: Body | None = None,
) -> Chain:
    """Read the chain of moving joints from a URDF, fixed and locked joints merged.

    Args:
        robot: the URDF's root element.
        where: what to call it in refusals.
        asks: what to call the scene there, which names the locked joints and the tool.
        locked: joints held at a position [rad or m].
        tool: the link that carries `payload`, which is given in that link's frame.
        payload: a body to add at the tool.

    Raises:
        Refusal: it is no URDF, or its machine is no serial chain with sound inertias.
    """
    moving = _with_bodies(robot, where, asks, locked, tool, payload)
    of_joints = followers(robot, where, list(locked))
    coupling = coupling_of([one.joint.name for one in moving], of_joints, where)
    faults = [fault for one in moving if (fault := _fault_of_body(one, where)) is not None]
    if faults:
        raise _all_of(faults, where)
    return _assemble(moving, coupling)


@dataclass(frozen=True)
class MovedBody:
    """Body moved by a joint: a link with all links fixed to it."""

    joint: str
    links: tuple[str, ...]
    tip: Array
    """Origin of the next joint, of the last one's links the farthest, in the first link's frame."""
    fault: Refusal | None
    """Why the equations of motion are not solvable with it."""


def moved_bodies(
    robot: ET.Element, where: str, asks: str, *, locked: Mapping[str, float], tool: str
) -> list[MovedBody]:
    """Return what each moving joint of a URDF moves, base to tip; arguments as `read_chain`'s.

    Raises:
        Refusal: it is no URDF, or its machine is no serial chain.
    """
    moving = _with_bodies(robot, where, asks, locked, tool, None)
    tips = [one.placement.p for one in moving[1:]]
    tips.append(max((frame.p for frame in moving[-1].frames), key=lambda p: float(p @ p)))
    return [
        MovedBody(one.joint.name, tuple(one.links), tip, _fault_of_body(one, where))
        for one, tip in zip(moving, tips, strict=True)
    ]


def _all_of(faults: list[Refusal], where: str) -> Refusal:
    """Return one refusal of several bodies, with all causes and the way out."""
    way_out = "`arm_emulator new` assumes bodies from shapes, or give links an <inertial>"
    if len(faults) == 1:
        one = faults[0]
        return Refusal(where, one.quantity, one.rule, one.got, way_out)
    causes = "; ".join(f"{one.quantity} {one.got}" for one in faults)
    rule = "have mass and inertia"
    return Refusal(where, f"bodies of {len(faults)} joints", rule, causes, f"{way_out}: {causes}")


def _with_bodies(
    robot: ET.Element,
    where: str,
    asks: str,
    locked: Mapping[str, float],
    tool: str,
    payload: Body | None,
) -> list[_Moving]:
    """Return the chain of moving joints with what they move."""
    links = _names_of(robot, "link", where)
    joints = _read_joints(robot, links, where)
    known = {joint.name for joint in joints}
    for name in locked:
        if name not in known:
            raise Refusal(asks, f"locked.{name}", "be a joint of the URDF", name, _names(joints))
    for joint in joints:
        _check_kind(joint, locked, where)
    if tool not in links:
        raise Refusal(asks, "tool", "be a link of the URDF", tool, ", ".join(links))
    moving = _moving_joints(_root(links, joints, where), links, joints, locked, where)
    bodies = _read_bodies(robot, where)
    for one in moving:
        one.body = (
            bodies.some([links[link] for link in one.links])
            .seen_from(
                np.array([frame.R for frame in one.frames]),
                np.array([frame.p for frame in one.frames]),
            )
            .sum()
        )
        if payload is not None and tool in one.links:
            one.body += payload.seen_from(one.frames[one.links.index(tool)])
    return moving


def _check_kind(joint: _UrdfJoint, locked: Mapping[str, float], where: str) -> None:
    """Refuse a joint that an arm cannot move, with a hint at how it can be locked."""
    if joint.kind not in FREE_KINDS:
        return
    held = "locked: {" + joint.name + ": 0.0}"
    if joint.name not in locked:
        raise Refusal(
            where, f"joint {joint.name}: type", "be one the emulator knows", joint.kind,
            f"revolute, continuous, prismatic, fixed, or held where it is in the scene: {held}",
        )  # fmt: skip
    if locked[joint.name] != 0.0:
        rule = f"be 0, where a {joint.kind} joint is held"
        raise Refusal(where, f"locked.{joint.name}", rule, locked[joint.name])


# Elements of a URDF that only moving joints have, or have in another form.
_OF_MOVING = ("origin", "axis", "limit", "mimic", "coupling", "dynamics", "safety_controller")


def lock_joints(robot: ET.Element, locked: Mapping[str, float], where: str) -> bool:
    """Make the `locked` joints fixed at their positions, and joints without limits unlimited.

    Returns:
        Whether anything was changed.
    """
    elements = [e for e in robot.findall("joint") if e.get("name") in locked]
    for element, joint in zip(elements, _parsed_joints(elements, where), strict=True):
        held = _moved(joint, locked[joint.name])
        for tag in _OF_MOVING:
            for old in element.findall(tag):
                element.remove(old)
        element.set("type", "fixed")
        xyz, rpy = (" ".join(map(repr, map(float, a))) for a in (held.p, _rpy(held.R)))
        ET.SubElement(element, "origin", xyz=xyz, rpy=rpy)
    return complete_limits(robot, where) or bool(locked)


# Reading the XML: numbers are collected first, then turned into frames and bodies all at once


def _names_of(robot: ET.Element, tag: str, where: str) -> dict[str, int]:
    """Return the names of the robot's links or joints, with their places."""
    names: dict[str, int] = {}
    for place, element in enumerate(robot.findall(tag)):
        name = element.get("name") or ""
        if not name or name in names:
            raise Refusal(where, f"{tag} name", "be given and unique", repr(name))
        if not name.isprintable():
            raise Refusal(where, f"{tag} name", "have printable letters only", repr(name))
        names[name] = place
    return names


def _read_joints(robot: ET.Element, links: Mapping[str, int], where: str) -> list[_UrdfJoint]:
    _names_of(robot, "joint", where)
    joints = _parsed_joints(robot.findall("joint"), where)
    for joint in joints:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                rule = "be a link of the URDF"
                raise Refusal(where, f"joint {joint.name}: {role}", rule, repr(link))
    return joints


def _parsed_joints(elements: list[ET.Element], where: str) -> list[_UrdfJoint]:
    whats = [f"joint {element.get('name')}" for element in elements]
    placements = _frames([e.find("origin") for e in elements], whats, "origin", where)
    joints = []
    for element, what, placement in zip(elements, whats, placements, strict=True):
        kind = element.get("type") or ""
        if kind not in ("fixed", *MOVING_KINDS, *FREE_KINDS):
            raise Refusal(
                where, f"{what}: type", "be one the emulator knows", kind or "nothing",
                "revolute, continuous, prismatic, fixed",
            )  # fmt: skip
        axis = _X if kind == "fixed" else _axis(element.find("axis"), f"{what}: axis", where)
        parent, child = element.find("parent"), element.find("child")
        joints.append(
            _UrdfJoint(
                name=element.get("name") or "",
                kind=kind,
                parent="" if parent is None else parent.get("link") or "",
                child="" if child is None else child.get("link") or "",
                placement=placement,
                axis=axis,
            )
        )
    return joints


def _axis(element: ET.Element | None, what: str, where: str) -> Array:
    if element is None:
        return _X
    axis = np.array(_numbers(element.get("xyz", "1 0 0"), 3, f"{what} xyz", where))
    _check_size(axis[None], LARGEST_LENGTH, [what], "xyz", where)
    length = float(np.linalg.norm(axis))
    if length < 1e-6:
        raise Refusal(where, what, "have a direction", tuple(map(float, axis)))
    return axis / length


def _read_bodies(robot: ET.Element, where: str) -> Bodies:
    """Return the bodies of all links, in their order; without an inertial a link has none."""
    links = robot.findall("link")
    rows, whats, origins, places = [], [], [], []
    for place, link in enumerate(links):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        what = f"link {link.get('name')}"
        mass, tensor = inertial.find("mass"), inertial.find("inertia")
        if mass is None or tensor is None:
            raise Refusal(where, f"{what}: inertial", "hold <mass> and <inertia>", "only a part")
        texts = [mass.get("value"), *map(tensor.get, _TENSOR)]
        try:
            rows.append([float(text) for text in texts])  # type: ignore[arg-type]
        except (TypeError, ValueError):
            for key, text in zip(("mass", *_TENSOR), texts, strict=True):
                _numbers(text, 1, f"{what}: {key}", where)
        whats.append(what)
        origins.append(inertial.find("origin"))
        places.append(place)
    values = np.array(rows).reshape(-1, 7)
    _check_size(values[:, :1], LARGEST_MASS, whats, "mass", where)
    _check_size(values[:, 1:], LARGEST_INERTIA, whats, "inertia", where)
    for place in np.flatnonzero(values[:, 0] < 0.0).tolist():
        raise Refusal(where, f"{whats[place]}: mass", "be >= 0 kg", float(values[place, 0]))
    frames = _frames(origins, whats, "inertial origin", where)
    everywhere = Bodies(
        np.zeros(len(links)), np.zeros((len(links), 3)), np.zeros((len(links), 3, 3))
    )
    if not places:
        return everywhere
    R = np.array([frame.R for frame in frames])
    inertia = R @ values[:, 1:][:, _FULL_TENSOR] @ R.transpose(0, 2, 1)
    bodies = Bodies.from_center(values[:, 0], np.array([frame.p for frame in frames]), inertia)
    everywhere.mass[places] = bodies.mass
    everywhere.moment[places] = bodies.moment
    everywhere.inertia[places] = bodies.inertia
    return everywhere


_TENSOR = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_FULL_TENSOR = [[0, 3, 4], [3, 1, 5], [4, 5, 2]]  # places of the entries above


def check_inertia(inertia: Array, what: str, where: str) -> None:
    """Refuse a tensor (3, 3) [kg m2] about the centre of mass that is not positive definite."""
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] <= 1e-12 * moments[2]:
        shown = ", ".join(f"{moment:.3g}" for moment in moments)
        raise Refusal(
            where, what, "be positive definite, principal moments > 0 kg m2", f"({shown})"
        )


def _frames(
    origins: list[ET.Element | None], whats: list[str], name: str, where: str
) -> list[Frame]:
    """Return the frames of elements <origin>."""
    rows, no_turn = [], (0.0,) * 6
    for origin, what in zip(origins, whats, strict=True):
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
            _numbers(xyz, 3, f"{what}: {name} xyz", where)
            _numbers(rpy, 3, f"{what}: {name} rpy", where)
        rows.append((x, y, z, roll, pitch, yaw))
    values = np.array(rows).reshape(-1, 6)
    _check_size(values[:, :3], LARGEST_LENGTH, whats, f"{name} xyz", where)
    _check_size(values[:, 3:], LARGEST_ANGLE, whats, f"{name} rpy", where)
    R = _clean(
        _turns(2, values[:, 5].tolist())
        @ _turns(1, values[:, 4].tolist())
        @ _turns(0, values[:, 3].tolist())
    )
    turned = (values[:, 3:] != 0.0).any(axis=1).tolist()
    p = values[:, :3].copy()
    return [Frame(R[k] if turned[k] else _EYE, p[k]) for k in range(len(rows))]


def frame_of(xyz: Iterable[float], rpy: Iterable[float]) -> Frame:
    """Return the frame at `xyz` [m], turned by roll, pitch and yaw [rad] as in a URDF."""
    turns = (_turn(axis, angle) for axis, angle in enumerate(rpy))
    roll, pitch, yaw = turns
    return Frame(_clean(yaw @ pitch @ roll), np.array(tuple(xyz)))


def _numbers(text: str | None, count: int, what: str, where: str) -> list[float]:
    words = (text or "").split() if count > 1 else [text or ""]
    if len(words) != count:
        raise Refusal(where, what, "be three numbers", repr(text))
    try:
        return [float(word) for word in words]
    except ValueError:
        raise Refusal(where, what, "be a number", repr(text)) from None


def _check_size(values: Array, largest: float, whats: list[str], name: str, where: str) -> None:
    """Refuse rows (K, ...) of which an entry is not finite or too large."""
    for row, column in np.argwhere(~(np.abs(values) <= largest)).tolist():
        value = float(values[row, column])
        rule = f"be from {-largest:g} to {largest:g}" if math.isfinite(value) else "be finite"
        raise Refusal(where, f"{whats[row]}: {name}", rule, value)


# From the tree to the chain


def _root(links: Mapping[str, int], joints: list[_UrdfJoint], where: str) -> str:
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
        got = ", ".join(roots) if roots else "none (a loop)"
        raise Refusal(where, "robot", rule, got)
    return roots[0]


@dataclasses.dataclass
class _Moving:
    """A moving joint, its placement in the frame of the last moving link, and what it moves."""

    joint: _UrdfJoint
    placement: Frame
    links: list[str]  # its child and all that is fixed to it
    frames: list[Frame]  # of the links, in that of the child
    body: Body  # of all of them


def _moving_joints(
    root: str,
    links: Mapping[str, int],
    joints: list[_UrdfJoint],
    locked: Mapping[str, float],
    where: str,
) -> list[_Moving]:
    below: dict[str, list[_UrdfJoint]] = {}
    for joint in joints:
        below.setdefault(joint.parent, []).append(joint)
    moving: list[_Moving] = []
    reached = {root}
    branch = [(root, Frame(), -1)]  # link, its frame in the carrying link's, the carrier's index
    while branch:
        link, frame, carrier = branch.pop()
        for joint in below.get(link, []):
            reached.add(joint.child)
            if joint.kind == "fixed" or joint.name in locked:
                at = frame @ _moved(joint, locked.get(joint.name, 0.0))
                if carrier >= 0:
                    moving[carrier].links.append(joint.child)
                    moving[carrier].frames.append(at)
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
            moving.append(_Moving(joint, frame @ joint.placement, [joint.child], [Frame()], Body()))
            branch.append((joint.child, Frame(), len(moving) - 1))
    lost = [name for name in links if name not in reached]
    if lost:
        raise Refusal(where, f"link {lost[0]}", "hang on the base (it is in a loop)", lost[0])
    if not moving:
        raise Refusal(where, "robot", "have a moving joint", "none")
    if len(moving) > MOST_JOINTS:
        rule = f"have at most {MOST_JOINTS} moving joints that are not locked"
        raise Refusal(where, "robot", rule, len(moving))
    return moving


def _moved(joint: _UrdfJoint, position: float) -> Frame:
    """Return the child's frame in the parent's with the joint at `position`."""
    if joint.kind == "fixed" or joint.kind in FREE_KINDS:
        return joint.placement
    if joint.kind == "prismatic":
        return joint.placement @ Frame(p=position * joint.axis)
    a = _cross(joint.axis)
    return joint.placement @ Frame(
        np.eye(3) + math.sin(position) * a + (1.0 - math.cos(position)) * a @ a
    )


def _assemble(moving: list[_Moving], coupling: Coupling) -> Chain:
    """Choose each link's frame: z along its joint, x so that the next joint's tilt is about x.

    With z fixed, one free turn gamma about z is left per link. It is spent so that the next axis,
    seen from this link, lies in the plane x = 0: then the turn to the next link is Rx(alpha) and
    nothing else, as in the convention of Denavit, Hartenberg and Khalil.
    """
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
                axes=turned[index].T,
                links=dict(zip(one.links, one.frames, strict=True)),
            )
        )
    carried = {
        link: (index, frame)
        for index, one in enumerate(moving)
        for link, frame in zip(one.links, one.frames, strict=True)
    }
    return Chain(tuple(joints), coupling, R_WB.T, np.array([R.T for R in turned]), carried)


def _fault_of_body(one: _Moving, where: str) -> Refusal | None:
    """Return why the equations of motion are not solvable with what a joint moves.

    The mass matrix is positive definite in every pose if no body has a negative principal moment
    and each has inertia about its own joint's axis (mass, along the axis of a prismatic one). So a
    thin rod or a point mass may be moved, though not a rod about its own length.
    """
    body, what = one.body, f"moved by joint {one.joint.name} (links {', '.join(one.links)})"
    if not body.mass >= SMALLEST_MASS:
        rule = "be > 0 kg" if body.mass <= 0.0 else f"be >= {SMALLEST_MASS:g} kg"
        return Refusal(where, f"mass {what}", rule, body.mass)
    com_x = _cross(body.moment / body.mass)
    moments = np.linalg.eigvalsh(body.inertia + body.mass * com_x @ com_x)
    rounding = 1e-12 * np.abs(body.inertia).max()
    thin = moments[0] <= 1e-9 * moments[2] + rounding
    shown = "(" + ", ".join(f"{moment:.3g}" for moment in moments) + ")"
    if moments[0] < -1e-9 * moments[2] - rounding:
        return Refusal(where, f"inertia {what}", "have principal moments >= 0 kg m2", shown)
    if thin and moments[2] - moments[1] > 1e-3 * moments[2] + rounding:
        rule = "be positive definite (of a thin rod: with two equal principal moments)"
        return Refusal(where, f"inertia {what}", rule, shown)
    about = float(one.joint.axis @ body.inertia @ one.joint.axis)
    least = max(SMALLEST_INERTIA, float(rounding))
    if MOVING_KINDS[one.joint.kind] == "revolute" and about < least:
        return Refusal(where, f"inertia about the axis {what}", f"be >= {least:.2g} kg m2", about)
    return None


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
    R: Array = _turns(axis, [angle])[0]
    return R


def _turns(axis: int, angles: Iterable[float]) -> Array:
    """Return rotations (K, 3, 3) about one axis."""
    # By `math`: NumPy's cosine may round differently on another processor.
    c, s = (np.array(list(map(f, angles))) for f in (math.cos, math.sin))
    R = np.tile(np.eye(3), (len(c), 1, 1))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R[:, i, i], R[:, i, j], R[:, j, i], R[:, j, j] = c, -s, s, c
    return _clean(R)


def _rpy(R: Array) -> Array:
    """Return roll, pitch and yaw of Rz(yaw) Ry(pitch) Rx(roll)."""
    # The roll is that of Rz(-yaw) R, whatever the yaw is: where the pitch is a quarter of a turn
    # or near it, R hardly knows roll and yaw apart, but what they make of it stays R.
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    yaw = _exact_atan2(float(R[1, 0]), float(R[0, 0]))
    s, c = math.sin(yaw), math.cos(yaw)
    return np.array([math.atan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1]), pitch, yaw])


def _clean(R: Array) -> Array:
    """Return a rotation with entries that rounding moved off 0 and +-1 put back.

    Zeros are what the compiler folds; the threshold is a few units of the last place.
    """
    nearest = np.rint(R)
    return np.where(np.abs(R - nearest) < 1e-15, nearest, R) + 0.0


def _cross(a: Array) -> Array:
    """Return the matrix (..., 3, 3) that takes the cross product with a (..., 3)."""
    out = np.zeros((*a.shape, 3))
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -z, y, -x
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = z, -y, x
    return out


def _names(joints: list[_UrdfJoint]) -> str:
    return ", ".join(joint.name for joint in joints)
