"""Whether the motion controller of a new scene watches that parts of the arm do not touch."""

from __future__ import annotations

import numpy as np

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.chain import Array
from arm_emulator.motion.collisions import Collisions
from arm_emulator.motion.motion_config import MotionConfig

_DRAWN = 100  # poses within the limits
_MOST = 0.8  # share of them: shapes that overlap nearly everywhere are not those of the arm


def own_shapes(urdf_xml: str, joint_names: tuple[str, ...]) -> Collisions | None:
    """Return the test of an arm against itself; None: its shapes cannot be read.

    Args:
        urdf_xml: the robot description, with meshes that can be found.
        joint_names: the joints commanded.
    """
    try:
        return Collisions(urdf_xml, joint_names, (), MotionConfig().collision_margin)
    except Refusal:
        return None


def own_collisions(tested: Collisions | None, start: Array) -> tuple[str, str]:
    """Return the parameter `collisions` for an arm, and the reason.

    Args:
        tested: of `own_shapes`.
        start: angles of the joints at the start (N,) [rad or m].
    """
    if tested is None:
        return "off", "the shapes of the description cannot be read"
    if not tested.pairs:
        return "auto", "no parts of the arm can touch each other; stop with obstacles"
    if touching := tested.first(start):
        return "off", f"{touching} touch wherever it could start"
    rng = np.random.default_rng(0)
    share = np.mean([bool(tested.first(tested.drawn(rng))) for _ in range(_DRAWN)])
    if share > _MOST:
        return "off", f"parts of the arm touch in {share:.0%} of its poses"
    return "stop", "before parts of the arm touch each other"
