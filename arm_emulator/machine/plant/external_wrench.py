"""External wrenches on links: forces and moments (core/mechanics/links/external_wrench.hpp)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from arm_emulator.base.arrays import Array
from arm_emulator.base.products import apply_matrix
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.frames import Frame
from arm_emulator.base.validation.bound import FORCE, MOMENT, POINT
from arm_emulator.base.validation.number import Number
from arm_emulator.machine.scene.scene import Scene

AXES = ("link", "world")
NONE = (0.0, 0.0, 0.0)
NUMBERS = 10  # of a wrench in the point of a machine (arm_get_point)


@dataclass(frozen=True)
class ExternalWrench:
    """Force and moment at a point that is fixed to a link.

    Each is (3,); for the arms of a fleet a row each may be given, (arms, 3).

    Attributes:
        force: [N].
        moment: about the point [N m].
        point: in the link's frame [m].
        axes: of force and moment: "link", those of the link's frame, with which they turn, or
            "world".
    """

    force: ArrayLike = NONE
    moment: ArrayLike = NONE
    point: ArrayLike = NONE
    axes: str = "link"


def move_to_moving_link(
    scene: Scene, where: str, link: str, wrench: ExternalWrench, *arms: int
) -> tuple[int, ExternalWrench]:
    """Return the same wrench as one on a link of the chain, and that link's place in it.

    Args:
        scene: the machine.
        where: name for refusals.
        link: any link of the URDF that moves; its frame is the wrench's.
        wrench: what acts on it.
        arms: how many of a fleet, whose vectors may be rows, (arms, 3); nothing for one machine.

    Raises:
        Refusal: the scene has none, no such link, or numbers that are not finite or too large.
    """
    if not scene.external_wrench:
        raise Refusal(scene.where, "external_wrench", "be true", "false or absent")
    if not isinstance(wrench, ExternalWrench):
        raise Refusal(where, "wrench", "be an ExternalWrench", wrench)
    if not isinstance(wrench.axes, str) or wrench.axes not in AXES:
        raise Refusal(where, "axes", "be known", wrench.axes, ", ".join(AXES))
    place, frame = _find_frame(scene, where, link)
    R = frame.R if wrench.axes == "link" else None
    force = _read_vectors(where, FORCE, wrench.force, arms, R)
    moment = _read_vectors(where, MOMENT, wrench.moment, arms, R)
    point = _read_vectors(where, POINT, wrench.point, arms, frame.R) + frame.p
    if arms:
        return place, ExternalWrench(force, moment, point, wrench.axes)
    return place, ExternalWrench(tuple(force), tuple(moment), tuple(point), wrench.axes)


def _read_vectors(
    where: str, bound: Number, values: ArrayLike, arms: tuple[int, ...], R: Array | None
) -> Array:
    """Return a vector (3,), or of a fleet a row for each arm (arms, 3), turned by a rotation."""
    if values is NONE:  # as where a fault ends, once in every run of a campaign
        return np.zeros((*arms, 3))
    rows = bound.check_numbers(where, values) if arms else bound.check_row(where, values, 3)
    if arms:
        if rows.shape not in ((3,), (*arms, 3)):
            rule = f"have shape (3,) or ({arms[0]}, 3)"
            raise Refusal(where, bound.name, rule, rows.shape)
        bound.check_values(where, rows)
        rows = np.array(np.broadcast_to(rows, (*arms, 3)))
    return rows if R is None else apply_matrix(R, rows) + 0.0


def _find_frame(scene: Scene, where: str, link: str) -> tuple[int, Frame]:
    for place, carrier in scene.chain.bodies.items():
        if isinstance(link, str) and link in carrier.links:
            return place, carrier.links[link]
    names = [name for link in scene.chain.bodies.values() for name in link.links]
    raise Refusal(where, "link", "be one that moves", link, ", ".join(names))
