"""Pose of a tool."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from arm_emulator.base.array_equality import ArrayEquality
from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.bound import TOOL_POSITION
from arm_emulator.base.validation.number import Number

# A quaternion this far from length 1, and a matrix this far from a rotation, is rounding of its
# sender; farther, it is a mistake.
_UNIT_TOLERANCE = 1e-3
_ROTATION = Number.bound_size("R_WT", "", 1.0 + _UNIT_TOLERANCE)  # no entry of a rotation is larger
_ORIENTATION = Number.bound_size("orientation", "", math.inf)


@dataclass(frozen=True, eq=False, init=False)
class Pose(ArrayEquality):
    """Pose of the tool frame T in the world frame W."""

    p_WT: Array
    """Position (3,) [m]."""
    R_WT: Array
    """Rotation matrix (3, 3)."""

    def __init__(self, p_WT: npt.ArrayLike, R_WT: npt.ArrayLike) -> None:
        """Keep copies of both.

        Raises:
            Refusal: a wrong shape, not finite, too far away, or a matrix that is no rotation.
        """
        p = TOOL_POSITION.check_row("Pose", p_WT, 3).copy()
        R = np.array(_ROTATION.check_numbers("Pose", R_WT))
        if R.shape != (3, 3):
            raise Refusal("Pose", "R_WT", "have shape (3, 3)", R.shape)
        _ROTATION.check_values("Pose", R.ravel().tolist())
        off = float(np.abs(R @ R.T - np.eye(3)).max())
        if off > _UNIT_TOLERANCE:
            rule = f"be a rotation, R R' = 1 +- {_UNIT_TOLERANCE}"
            raise Refusal("Pose", "R_WT", rule, f"one off by {off:.3g}")
        if np.linalg.det(R) < 0.0:
            raise Refusal("Pose", "R_WT", "be a rotation", "a reflection")
        _store_arrays(self, p, R)

    @classmethod
    def computed(cls, p_WT: Array, R_WT: Array) -> Self:
        """Take both over as they are: results of a computation from poses."""
        pose = cls.__new__(cls)
        _store_arrays(pose, p_WT, R_WT)
        return pose

    @classmethod
    def from_quaternion(
        cls, position: npt.ArrayLike, quaternion: npt.ArrayLike, where: str = "tool_target"
    ) -> Self:
        """Take a pose as messages give it.

        Args:
            position: (3,) [m].
            quaternion: x, y, z, w (the order of geometry_msgs).
            where: name of the source, for refusals.

        Raises:
            Refusal: not finite, too far away, a wrong length, or a quaternion whose length is
                not 1.
        """
        p = TOOL_POSITION.check_row(where, position, 3).copy()
        q = _ORIENTATION.check_row(where, quaternion, 4)
        length = math.hypot(*q.tolist())  # of numbers of any size
        if abs(length - 1.0) > _UNIT_TOLERANCE:
            raise Refusal(
                where, "orientation", f"be a quaternion of length 1 +- {_UNIT_TOLERANCE}", length
            )
        x, y, z, w = q / length
        return cls(
            p,
            np.array(
                [
                    [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                    [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                    [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
                ]
            ),
        )

    def quaternion(self) -> Array:
        """Return the orientation as x, y, z, w with w >= 0, (4,)."""
        # The column of 4 q q' with the largest diagonal entry (Shepperd 1978): never near 0 / 0.
        R = self.R_WT
        xx, yy, zz = R[0, 0], R[1, 1], R[2, 2]
        outer = np.array(
            [
                [1 + xx - yy - zz, R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[2, 1] - R[1, 2]],
                [R[0, 1] + R[1, 0], 1 - xx + yy - zz, R[1, 2] + R[2, 1], R[0, 2] - R[2, 0]],
                [R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], 1 - xx - yy + zz, R[1, 0] - R[0, 1]],
                [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], 1 + xx + yy + zz],
            ]
        )
        q: Array = outer[:, int(np.argmax(np.diag(outer)))]
        q = q / np.linalg.norm(q)
        return -q if q[3] < 0.0 else q


def _store_arrays(pose: Pose, p_WT: Array, R_WT: Array) -> None:
    for name, array in (("p_WT", p_WT), ("R_WT", R_WT)):
        array.setflags(write=False)
        object.__setattr__(pose, name, array)
