"""Tool positions for many joint angles at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from arm_emulator.base.refusal import Refusal

if TYPE_CHECKING:
    from rerun.urdf import UrdfJoint, UrdfTree

Array = NDArray[np.float64]


class ToolPosition:
    """Forward kinematics of one link's origin.

    Walking from the tool to the base, each joint moves the point p by its own motion and then by
    its placement: p <- R (p turned about the axis by q) + o, the turn by Rodrigues' formula.

    Args:
        tree: the URDF.
        joint_names: the moving joints, in the order of the columns of q.
        tool: the link whose origin is wanted.

    Raises:
        Refusal: the tool is no link of the URDF.
    """

    def __init__(self, tree: UrdfTree, joint_names: Sequence[str], tool: str) -> None:
        joints = tree.joints()
        above = {joint.child_link: joint for joint in joints}
        links = {tree.root_link().name, *above}
        if tool not in links:
            raise Refusal("URDF", "tool", "be a link of it", tool, ", ".join(sorted(links)))
        columns = {name: column for column, name in enumerate(joint_names)}
        self._steps: list[_Step] = []
        self._p_start = np.zeros(3)  # the tool in the frame of the last moving link
        link = tool
        while link in above:
            joint = above[link]
            R, origin = _rotation(*joint.origin_rpy), np.array(joint.origin_xyz)
            if joint.name in columns:
                self._steps.append(_Step(joint, columns[joint.name], R, origin))
            elif self._steps:
                self._steps[-1].place(R, origin)
            else:
                self._p_start = R @ self._p_start + origin
            link = joint.parent_link

    def __call__(self, q: Array) -> Array:
        """Return p_WT (K, 3) [m], the tool in the URDF's root frame, for q (K, N) [rad or m]."""
        p = np.tile(self._p_start, (len(q), 1))
        for step in self._steps:
            p = step.move(p, q[:, step.column, None])
        return p


class _Step:
    """A moving joint: its column of q, its axis, and its placement in the moving link before it."""

    def __init__(self, joint: UrdfJoint, column: int, R: Array, origin: Array) -> None:
        self.column = column
        self._prismatic = joint.joint_type == "prismatic"
        self._R, self._origin = R, origin
        self._axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
        x, y, z = self._axis
        self._cross_T = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])

    def place(self, R: Array, origin: Array) -> None:
        """Hang this joint's placement on a fixed joint before it."""
        self._R = R @ self._R
        self._origin = R @ self._origin + origin

    def move(self, p: Array, position: Array) -> Array:
        """Move points p (K, 3) by the joint at `position` (K, 1) and by its placement."""
        if self._prismatic:
            p = p + position * self._axis
        else:
            across = p @ self._cross_T
            p = p + np.sin(position) * across + (1.0 - np.cos(position)) * (across @ self._cross_T)
        return p @ self._R.T + self._origin


def _rotation(roll: float, pitch: float, yaw: float) -> Array:
    """Return Rz(yaw) Ry(pitch) Rx(roll), the order of URDF."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
