"""Many poses of a tool, as arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from arm_emulator.motion.pose import Pose

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of a tool in a row."""

    p: FloatArray
    """(K, 3) [m]."""
    R: FloatArray
    """(K, 3, 3)."""

    def __getitem__(self, places: slice) -> Poses:
        """Return some of them."""
        return Poses(self.p[places], self.R[places])


def along_a_line(begin: Pose, end: Pose, parts: FloatArray, other_way: bool = False) -> Poses:
    """Return poses at shares (K,) of a straight way that turns evenly about one axis.

    Half a turn at most, or the other way round: what is left of a whole one.
    """
    p = begin.p_WT + parts[:, None] * (end.p_WT - begin.p_WT)
    turn = pin.log3(end.R_WT @ begin.R_WT.T)
    angle = math.hypot(*turn)
    axis = pin.skew(turn / angle if angle > 0.0 else turn)
    if other_way:
        angle -= 2.0 * math.pi
    once, angles = axis @ begin.R_WT, parts[:, None, None] * angle
    twice = axis @ once
    return Poses(p, begin.R_WT + np.sin(angles) * once + 2.0 * np.sin(0.5 * angles) ** 2 * twice)


def rotations(vectors: FloatArray) -> FloatArray:
    """Return the rotation matrices of rotation vectors (K, 3), (K, 3, 3)."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = vectors.T
    none = np.zeros_like(x)
    K = np.stack([none, -z, y, z, none, -x, -y, x, none], axis=1).reshape(-1, 3, 3)
    with np.errstate(invalid="ignore", divide="ignore"):
        first = np.where(angle > 1e-6, np.sin(angle) / angle, 1.0)
        second = np.where(angle > 1e-6, 2.0 * (np.sin(0.5 * angle) / angle) ** 2, 0.5)
    return np.asarray(np.eye(3) + first * K + second * (K @ K))
