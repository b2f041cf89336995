"""External wrenches on links: forces and moments (core/mechanics/external_wrench.hpp)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from arm_emulator.base.bound import FORCE, MOMENT, POINT
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.chain import Array, Frame
from arm_emulator.machine.scene import Scene

AXES = ("link", "world")
NONE = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class ExternalWrench:
    """Force and moment at a point that is fixed to a link.

    Attributes:
        force: (3,) [N].
        moment: (3,) about the point [N m].
        point: (3,) in the link's frame [m].
        axes: of force and moment: "link", those of the link's frame, with which they turn, or
            "world".
    """

    force: Sequence[float] = NONE
    moment: Sequence[float] = NONE
    point: Sequence[float] = NONE
    axes: str = "link"


def on_moving_link(
    scene: Scene, where: str, link: str, wrench: ExternalWrench
) -> tuple[int, ExternalWrench]:
    """Return the same wrench as one on the link that a joint moves, and that joint's index.

    Args:
        scene: the machine.
        where: name for refusals.
        link: any link of the URDF that moves; its frame is the wrench's.
        wrench: what acts on it.

    Raises:
        Refusal: the scene has none, no such link, or numbers that are not finite or too large.
    """
    if not scene.external_wrench:
        raise Refusal(scene.where, "external_wrench", "be true", "false or absent")
    if wrench.axes not in AXES:
        raise Refusal(where, "axes", "be known", wrench.axes, ", ".join(AXES))
    rows = [
        bound.row(where, values, 3)
        for bound, values in (
            (FORCE, wrench.force), (MOMENT, wrench.moment), (POINT, wrench.point)
        )
    ]  # fmt: skip
    joint, frame = _frame_of(scene, where, link)
    force, moment, point = rows
    if wrench.axes == "link":
        force, moment = _turned(frame.R, force), _turned(frame.R, moment)
    point = _turned(frame.R, point) + frame.p
    return joint, ExternalWrench(
        tuple(force.tolist()), tuple(moment.tolist()), tuple(point.tolist()), wrench.axes
    )


def _frame_of(scene: Scene, where: str, link: str) -> tuple[int, Frame]:
    for index, joint in enumerate(scene.chain.joints):
        if isinstance(link, str) and link in joint.links:
            return index, joint.links[link]
    known = [name for joint in scene.chain.joints for name in joint.links]
    raise Refusal(where, "link", "be one that moves", link, ", ".join(known))


def _turned(R: Array, a: ArrayLike) -> Array:
    out: Array = R @ np.asarray(a)
    return out
