"""Whether a body can have the inertia that a robot description gives for a link.

A body's principal moments are those of some distribution of mass: none is negative, and the largest
is at most the sum of the others. Its radius of gyration is bounded by its size, and its density by
materials. Shapes may show a part of a link only, so a link that does not fit them is doubtful. What
moves is a link with all that is fixed to it: it is impossible if no body has their sum, or if it is
larger than the arm or lighter than air. Parameters that are identified or regrouped need not be
those of a body: scenes list such links under `trusted_inertias`.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.frames import compute_cross
from arm_emulator.base.warning import print_warnings
from arm_emulator.design.assumed_bodies import read_shape_body
from arm_emulator.machine.chain import Body, Chain
from arm_emulator.machine.scene.urdf_bodies import read_bodies

ROUNDING = 0.01  # of the largest moment: figures of two digits
DENSITIES = 300.0, 3000.0  # kg/m3: 44 of 48 industrial arms lie between them, by their hulls
AIR = 1.2  # kg/m3: no link is lighter
# Radius of gyration over that of the shape, filled evenly. All mass at the ends of a rod gives 1.7.
LARGE, SMALL = 2.0, 0.1
MAX_WARNINGS = 10
REMEDY = (
    "`new --replace-inertias` computes inertias from shapes, `new --trust-inertias` and the scene's"
    " `trusted_inertias` take them as they are"
)


@dataclass(frozen=True)
class Doubt:
    """A link whose mass or inertia cannot be, or hardly is, that of a body."""

    link: str
    reason: str
    is_impossible: bool = False
    is_of_mass: bool = False
    """Whether its mass is in doubt, too."""

    def __str__(self) -> str:
        return f"link {self.link}: {self.reason}"


def list_doubtful_inertias(
    robot: ET.Element, where: str, folder: Path, chain: Chain, unchecked: Sequence[str] = ()
) -> list[Doubt]:
    """Return what is wrong with the inertias of moving links, base to tips.

    Args:
        robot: the URDF's root element.
        where: what to call it in refusals.
        folder: where its file lies, for meshes.
        chain: its moving joints.
        unchecked: links whose inertias need not be those of bodies.
    """
    elements = {link.get("name", ""): link for link in robot.findall("link")}
    bodies = read_bodies(robot, where)
    places = {name: place for place, name in enumerate(elements)}
    arm = sum(math.hypot(*joint.p) for joint in chain.links[1:]) + max(
        (math.hypot(*frame.p) for frame in chain.links[-1].links.values()), default=0.0
    )
    doubtful: list[Doubt] = []
    for joint in chain.bodies.values():
        own: list[Doubt] = []
        parts = [name for name in joint.links if name not in unchecked]
        alone = {name: bodies.get_body(places[name]) for name in parts}
        arm_body = Body()
        for name, frame in joint.links.items():
            arm_body = arm_body + bodies.get_body(places[name]).transform_to(frame)
        for name, body in alone.items():
            if elements[name].find("inertial") is not None:
                shape = _read_shape(elements[name], folder)
                own += _list_doubtful(
                    name, body, shape, _measure_length(robot, name), arm_body.mass
                )
        heaviest = max(parts, key=lambda name: alone[name].mass, default=None)
        if heaviest is not None and (reason := _explain_no_body(arm_body, arm)):
            own.insert(0, Doubt(heaviest, reason, is_impossible=True))
        doubtful += own
    return doubtful


def check_inertias(doubtful: Sequence[Doubt], where: str) -> None:
    """Warn of doubtful links, and refuse impossible ones.

    Raises:
        Refusal: names all that are impossible.
    """
    impossible = [doubt for doubt in doubtful if doubt.is_impossible]
    if impossible:
        first, valid = impossible[0], REMEDY
        others = dict.fromkeys(doubt.link for doubt in impossible if doubt.link != first.link)
        if others:
            valid += f"; likewise links {', '.join(others)}"
        raise Refusal(where, f"inertia of link {first.link}", "be a body's", first.reason, valid)
    for doubt in doubtful[:MAX_WARNINGS]:
        print_warnings(f"{where}: {doubt}")
    if len(doubtful) > MAX_WARNINGS:
        links = ", ".join(dict.fromkeys(doubt.link for doubt in doubtful[MAX_WARNINGS:]))
        print_warnings(f"{where}: doubtful inertias, too, of links {links}")
    if doubtful:
        print_warnings(f"{where}: doubtful inertias: {REMEDY}")


def _read_shape(link: ET.Element, folder: Path) -> Body | None:
    """Return the body of a link's shapes at 1 kg/m3, if they can be read."""
    try:
        return read_shape_body(link, folder)[0]
    except ImportError:  # coal, which reads meshes, is missing
        return None


def _measure_length(robot: ET.Element, link: str) -> float:
    """Return the distance from a link's origin to the farthest joint that it carries [m]."""
    length = 0.0
    for joint in robot.findall("joint"):
        parent, origin = joint.find("parent"), joint.find("origin")
        if parent is not None and parent.get("link") == link and origin is not None:
            length = max(length, math.hypot(*map(float, origin.get("xyz", "0 0 0").split())))
    return length


def _explain_no_body(body: Body, largest: float) -> str:
    """Return why no body moved by a joint has an inertia; empty: one may have.

    Args:
        body: the sum of all that the joint moves.
        largest: radius of gyration [m].
    """
    if body.mass <= 0.0:
        return ""  # refused where the machine is made
    if reason := _explain_no_moments(body):
        return reason
    radius = math.sqrt(_compute_moments(body)[2] / body.mass)
    if radius > largest > 0.0:
        return f"radius of gyration {radius:.3g} m, longer than the arm, {largest:.3g} m"
    return ""


def _explain_no_moments(body: Body) -> str:
    """Return why no body has these principal moments; empty: one has."""
    moments = _compute_moments(body)
    text = ", ".join(f"{moment:.3g}" for moment in moments)
    # A body as small as a point has moments near 0, computed as the difference of two large
    # tensors. Their rounding can be larger than what remains.
    rounding = ROUNDING * abs(moments[2]) + 1e-12 * np.abs(body.inertia).max()
    if moments[0] < -rounding:
        return f"a principal moment below 0: ({text}) kg m2"
    if moments[2] - moments[0] - moments[1] > rounding:
        return f"a principal moment above the sum of the others: ({text}) kg m2"
    return ""


def _list_doubtful(
    name: str, body: Body, shape: Body | None, length: float, moved: float
) -> list[Doubt]:
    """Return the doubts about one link.

    Args:
        name: of the link.
        body: that the description gives.
        shape: see `_read_shape`.
        length: see `_measure_length`.
        moved: mass of all that its joint moves [kg].
    """
    if body.mass <= 0.0:
        return [Doubt(name, "inertia without mass")] if body.inertia.any() else []
    doubtful: list[Doubt] = []
    if reason := _explain_no_moments(body):
        doubtful.append(Doubt(name, reason))
    if shape is None:
        return doubtful
    radius = math.sqrt(max(_compute_moments(body)[2], 0.0) / body.mass)
    density, filled = body.mass / shape.mass, math.sqrt(_compute_moments(shape)[2] / shape.mass)
    low, high = DENSITIES
    if not low <= density <= high:
        reason = f"{body.mass:.3g} kg in its shape, {density:.3g} kg/m3, not {low:g} to {high:g}"
        doubtful.append(Doubt(name, reason, density < AIR and body.mass > 0.5 * moved, True))
    if radius < SMALL * filled:
        doubtful.append(
            Doubt(name, f"radius of gyration {radius:.3g} m, of its shape {filled:.3g} m")
        )
    size = max(filled, length / math.sqrt(12.0))
    if radius > LARGE * size:
        reason = f"radius of gyration {radius:.3g} m, of its shape and length {size:.3g} m"
        doubtful.append(Doubt(name, reason))
    return doubtful


def _compute_moments(body: Body) -> Array:
    """Return the principal moments about the centre of mass, ascending (3,) [kg m2]."""
    com_x = compute_cross(body.moment / body.mass)
    moments = np.linalg.eigvalsh(body.inertia + body.mass * com_x @ com_x)
    return np.asarray(moments, dtype=np.float64)
