"""The tree of moving joints of a URDF, fixed and locked joints merged."""

from __future__ import annotations

import dataclasses
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.products import apply_matrix, measure_length, multiply_matrices
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.couplings import Coupling, list_followers, read_coupling
from arm_emulator.base.urdf.frames import (
    Frame,
    compute_atan2,
    compute_cross,
    compute_rotation,
    compute_rpy,
    round_rotation,
)
from arm_emulator.base.urdf.joint_tree import (
    FREE_KINDS,
    MOVING_KINDS,
    UrdfJoint,
    find_root,
    list_element_names,
    list_names,
    parse_joints,
    read_joints,
)
from arm_emulator.base.urdf.urdf_text import complete_limits
from arm_emulator.machine.chain import Body, Chain, ChainJoint
from arm_emulator.machine.scene.urdf_bodies import read_bodies

MAX_JOINTS = 200  # more are no arm, and would compile for hours
# Below these, moved by a joint, what is divided by them may overflow.
SMALLEST_MASS = 1e-12  # kg
SMALLEST_INERTIA = 1e-24  # kg m2
# Elements of a URDF that only moving joints have, or have in another form.
_OF_MOVING = ("origin", "axis", "limit", "mimic", "coupling", "dynamics", "safety_controller")


def read_chain(
    robot: ET.Element,
    where: str,
    asks: str,
    *,
    locked: Mapping[str, float],
    tool: str,
    payload: Body | None = None,
    deflections: tuple[str, ...] = (),
) -> Chain:
    """Read the tree of moving joints from a URDF, fixed and locked joints merged.

    Args:
        robot: the URDF's root element.
        where: what to call it in refusals.
        asks: what to call the scene there, which names the locked joints and the tool.
        locked: joints held at a position [rad or m].
        tool: the link that carries `payload`, which is given in that link's frame.
        payload: a body to add at the tool.
        deflections: joints that are those of bearings (bearings.py).

    Raises:
        Refusal: it is no URDF, or its machine is no tree with sound inertias.
    """
    moving = _add_bodies(robot, where, asks, locked, tool, payload)
    of_joints = list_followers(robot, where, list(locked))
    coupling = read_coupling([moved.joint.name for moved in moving], of_joints, where, locked)
    if deflections and not coupling.is_identity:
        rule, got = "be absent where joints are coupled", deflections[0]
        raise Refusal(asks, f"joints.{deflections[0]}", rule, got)
    bodies = [moved for moved in moving if moved.links[0] not in deflections]
    faults = [
        fault
        for moved in bodies
        if (fault := _explain_bad_body(moved, where, moved.joint.name in deflections)) is not None
    ]
    if faults:
        raise _collect_links(faults, where)
    return _assemble_chain(moving, coupling, deflections)


@dataclass(frozen=True)
class MovedBody:
    """Body moved by a joint: a link with all links fixed to it."""

    joint: str
    links: tuple[str, ...]
    tip: Array
    """Origin of the first joint that it carries, else of its links' the farthest, in the first's
    frame."""
    fault: Refusal | None
    """Reason for which the equations of motion are not solvable with it."""


def collect_moved_bodies(
    robot: ET.Element, where: str, asks: str, *, locked: Mapping[str, float], tool: str
) -> list[MovedBody]:
    """Return what each moving joint of a URDF moves, base to tips; arguments as `read_chain`'s.

    Raises:
        Refusal: it is no URDF, or its machine is no tree.
    """
    moving = _add_bodies(robot, where, asks, locked, tool, None)
    tips = [
        max((frame.p for frame in moved.frames), key=lambda p: float(p @ p)) for moved in moving
    ]
    for moved in moving[::-1]:
        if moved.parent >= 0:
            tips[moved.parent] = moved.placement.p
    return [
        MovedBody(moved.joint.name, tuple(moved.links), tip, _explain_bad_body(moved, where))
        for moved, tip in zip(moving, tips, strict=True)
    ]


def _collect_links(faults: list[Refusal], where: str) -> Refusal:
    """Return one refusal of several bodies, with all causes and the remedy."""
    remedy = "`arm_emulator new` assumes bodies from shapes, or give links an <inertial>"
    if len(faults) == 1:
        fault = faults[0]
        return Refusal(where, fault.quantity, fault.rule, fault.got, remedy)
    causes = "; ".join(f"{fault.quantity} {fault.got}" for fault in faults)
    rule = "have mass and inertia"
    return Refusal(where, f"bodies of {len(faults)} joints", rule, causes, f"{remedy}: {causes}")


def _add_bodies(
    robot: ET.Element,
    where: str,
    asks: str,
    locked: Mapping[str, float],
    tool: str,
    payload: Body | None,
) -> list[_Moving]:
    """Return the moving joints with what they move."""
    links = list_element_names(robot, "link", where)
    joints = read_joints(robot, links, where)
    names = {joint.name for joint in joints}
    for name in locked:
        if name not in names:
            raise Refusal(
                asks, f"locked.{name}", "be a joint of the URDF", name, list_names(joints)
            )
    for joint in joints:
        _check_kind(joint, locked, where)
    if tool not in links:
        raise Refusal(asks, "tool", "be a link of the URDF", tool, ", ".join(links))
    moving = _find_moving_joints(find_root(links, joints, where), links, joints, locked, where)
    bodies = read_bodies(robot, where)
    for moved in moving:
        moved.body = (
            bodies.select_bodies([links[link] for link in moved.links])
            .transform_to(
                np.array([frame.R for frame in moved.frames]),
                np.array([frame.p for frame in moved.frames]),
            )
            .sum_bodies()
        )
        if payload is not None and tool in moved.links:
            moved.body += payload.transform_to(moved.frames[moved.links.index(tool)])
    return moving


def _check_kind(joint: UrdfJoint, locked: Mapping[str, float], where: str) -> None:
    """Refuse a joint that an arm cannot move, with a hint at how it can be locked."""
    if joint.kind not in FREE_KINDS:
        return
    example = "locked: {" + joint.name + ": 0.0}"
    if joint.name not in locked:
        raise Refusal(
            where, f"joint {joint.name}: type", "be supported", joint.kind,
            f"revolute, continuous, prismatic, fixed, or held where it is in the scene: {example}",
        )  # fmt: skip
    if locked[joint.name] != 0.0:
        rule = f"be 0, where a {joint.kind} joint is held"
        raise Refusal(where, f"locked.{joint.name}", rule, locked[joint.name])


def lock_joints(robot: ET.Element, locked: Mapping[str, float], where: str) -> bool:
    """Make the `locked` joints fixed at their positions, and joints without limits unlimited.

    Returns:
        Whether anything was changed.
    """
    elements = [e for e in robot.findall("joint") if e.get("name") in locked]
    for element, joint in zip(elements, parse_joints(elements, where), strict=True):
        frame = joint.place_at(locked[joint.name])
        for tag in _OF_MOVING:
            for old in element.findall(tag):
                element.remove(old)
        element.set("type", "fixed")
        xyz, rpy = (" ".join(map(repr, map(float, a))) for a in (frame.p, compute_rpy(frame.R)))
        ET.SubElement(element, "origin", xyz=xyz, rpy=rpy)
    return complete_limits(robot, where) or bool(locked)


@dataclasses.dataclass
class _Moving:
    """A moving joint, its placement in the frame of its parent, and what it moves."""

    joint: UrdfJoint
    parent: int  # place of the moving joint that carries it; -1: the base
    placement: Frame
    links: list[str]  # its child and all that is fixed to it
    frames: list[Frame]  # of the links, in that of the child
    body: Body  # of all of them


def _find_moving_joints(
    root: str,
    links: Mapping[str, int],
    joints: list[UrdfJoint],
    locked: Mapping[str, float],
    where: str,
) -> list[_Moving]:
    below: dict[str, list[UrdfJoint]] = {}
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
                at = frame @ joint.place_at(locked.get(joint.name, 0.0))
                if carrier >= 0:
                    moving[carrier].links.append(joint.child)
                    moving[carrier].frames.append(at)
                branch.append((joint.child, at, carrier))
                continue
            placement = frame @ joint.placement
            moving.append(_Moving(joint, carrier, placement, [joint.child], [Frame()], Body()))
            branch.append((joint.child, Frame(), len(moving) - 1))
    lost = [name for name in links if name not in reached]
    if lost:
        raise Refusal(where, f"link {lost[0]}", "hang on the base (it is in a loop)", lost[0])
    if not moving:
        raise Refusal(where, "robot", "have a moving joint", "none")
    if len(moving) > MAX_JOINTS:
        rule = f"have at most {MAX_JOINTS} moving joints that are not locked"
        raise Refusal(where, "robot", rule, len(moving))
    return _sort_joints(moving)


def _sort_joints(moving: list[_Moving]) -> list[_Moving]:
    """Return the joints with all that each carries directly behind it, siblings as found."""
    carried: dict[int, list[int]] = {}
    for place, moved in enumerate(moving):
        carried.setdefault(moved.parent, []).append(place)
    order: list[int] = []
    left = carried[-1][::-1]
    while left:
        order.append(left.pop())
        left += carried.get(order[-1], [])[::-1]
    places = {before: after for after, before in enumerate(order)} | {-1: -1}
    return [dataclasses.replace(moving[k], parent=places[moving[k].parent]) for k in order]


def _assemble_chain(
    moving: list[_Moving], coupling: Coupling, deflections: tuple[str, ...]
) -> Chain:
    """Choose each link's frame: z along its joint, x so that the next joint's tilt is about x.

    With z fixed, one free turn gamma about z is left per link. It is spent so that the axis of the
    first joint that the link carries lies in the plane x = 0: then the turn to that link is
    Rx(alpha) and nothing else, as in the convention of Denavit, Hartenberg and Khalil. To further
    joints a turn about z comes before it, as in that of Khalil and Kleinfinger for trees.
    """
    # E: rotation of each link's core frame in its URDF frame, at gamma = 0.
    E = [_build_frame_with_z(moved.joint.axis) for moved in moving]
    gammas: list[float] = []
    for index, here in enumerate(E):
        if index + 1 == len(E) or moving[index + 1].parent != index:
            gammas.append(0.0)
            continue
        moved = moving[index + 1]
        z_next = round_rotation(
            apply_matrix(multiply_matrices(here.T, moved.placement.R), moved.joint.axis)
        )
        gammas.append(compute_atan2(float(z_next[0]), -float(z_next[1])))
    turned = [
        round_rotation(multiply_matrices(e, compute_rotation(2, gamma)))
        for e, gamma in zip(E, gammas, strict=True)
    ]
    R_WB = round_rotation(multiply_matrices(moving[0].placement.R, E[0]))
    joints = []
    for index, moved in enumerate(moving):
        cos_gamma, sin_gamma = 1.0, 0.0
        if index == 0:
            # The base's turn is free: with z along the first joint, that joint needs no tilt.
            R, p = compute_rotation(2, gammas[0]), apply_matrix(R_WB.T, moved.placement.p)
        else:
            before = turned[moved.parent] if moved.parent >= 0 else R_WB
            R = round_rotation(multiply_matrices(before.T, moved.placement.R, turned[index]))
            p = apply_matrix(before.T, moved.placement.p)
            if moved.parent != index - 1:
                x, y = float(R[0, 2]), -float(R[1, 2])
                if (length := math.hypot(x, y)) > 0.0:
                    cos_gamma, sin_gamma = y / length, x / length
                back = ((cos_gamma, sin_gamma, 0.0), (-sin_gamma, cos_gamma, 0.0), (0.0, 0.0, 1.0))
                R = round_rotation(multiply_matrices(np.array(back), R))
        # R = Rx(alpha) Rz(theta_0): its third column is (0, -sin alpha, cos alpha), its first row
        # (cos theta_0, -sin theta_0, 0).
        joints.append(
            ChainJoint(
                name=moved.joint.name,
                kind=MOVING_KINDS[moved.joint.kind],
                parent=moved.parent,
                cos_gamma=cos_gamma,
                sin_gamma=sin_gamma,
                cos_alpha=float(R[2, 2]),
                sin_alpha=float(-R[1, 2]),
                theta_0=compute_atan2(-float(R[0, 1]), float(R[0, 0])),
                p=p,
                body=moved.body.transform_to(Frame(turned[index].T)),
                axes=turned[index].T,
                links=dict(zip(moved.links, moved.frames, strict=True)),
            )
        )
    carried = {
        link: (index, frame)
        for index, moved in enumerate(moving)
        for link, frame in zip(moved.links, moved.frames, strict=True)
        if link not in deflections
    }
    R_core = np.array([R.T for R in turned])
    return Chain(tuple(joints), coupling, R_WB.T, R_core, carried, deflections)


def _explain_bad_body(moved: _Moving, where: str, in_bearing: bool = False) -> Refusal | None:
    """Return why the equations of motion are not solvable with what a joint moves.

    The mass matrix is positive definite in every pose under two conditions. No body has a negative
    principal moment, and each has inertia about its own joint's axis (mass, along the axis of a
    prismatic one). So a joint may move a thin rod or a point mass, but not a rod about its own
    length. In a compliant bearing, where a body moves in several directions, neither is accepted.
    """
    body, label = moved.body, f"moved by joint {moved.joint.name} (links {', '.join(moved.links)})"
    if not body.mass >= SMALLEST_MASS:
        rule = "be > 0 kg" if body.mass <= 0.0 else f"be >= {SMALLEST_MASS:g} kg"
        return Refusal(where, f"mass {label}", rule, body.mass)
    com_x = compute_cross(body.moment / body.mass)
    moments = np.linalg.eigvalsh(body.inertia + body.mass * com_x @ com_x)
    rounding = 1e-12 * np.abs(body.inertia).max()
    thin = moments[0] <= 1e-9 * moments[2] + rounding
    text = "(" + ", ".join(f"{moment:.3g}" for moment in moments) + ")"
    if moments[0] < -1e-9 * moments[2] - rounding:
        return Refusal(where, f"inertia {label}", "have principal moments >= 0 kg m2", text)
    if thin and moments[2] - moments[1] > 1e-3 * moments[2] + rounding:
        rule = "be positive definite (of a thin rod: with two equal principal moments)"
        return Refusal(where, f"inertia {label}", rule, text)
    about = float(moved.joint.axis @ body.inertia @ moved.joint.axis)
    smallest = max(SMALLEST_INERTIA, float(rounding))
    if in_bearing and (thin or moments[0] < smallest):
        rule = "be positive definite in a bearing that gives way"
        return Refusal(where, f"inertia {label}", rule, text)
    if MOVING_KINDS[moved.joint.kind] == "revolute" and about < smallest:
        return Refusal(
            where, f"inertia about the axis {label}", f"be >= {smallest:.2g} kg m2", about
        )
    return None


def _build_frame_with_z(axis: Array) -> Array:
    """Return a rotation whose third column is `axis`, made of zeros and ones where possible."""
    z = axis
    helper = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = helper - apply_matrix(helper[None], z) * z
    x = x / measure_length(x)
    return round_rotation(np.column_stack([x, np.cross(z, x), z]))
