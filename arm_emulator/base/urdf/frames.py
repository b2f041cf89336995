"""Frames in three dimensions, with the same bits on every processor."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.products import apply_matrix, multiply_matrices


def _make_constant(values: object) -> Array:
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


_ZERO = _make_constant(np.zeros(3))
X_AXIS = _make_constant([1.0, 0.0, 0.0])
EYE = _make_constant(np.eye(3))  # recognised, since many frames have no rotation


@dataclass(frozen=True)
class Frame:
    """A frame seen from another: rotation `R` (3, 3) and origin `p` (3,) [m]."""

    R: Array = field(default_factory=lambda: EYE)
    p: Array = field(default_factory=lambda: _ZERO)

    def __matmul__(self, other: Frame) -> Frame:
        R = self.R if other.R is EYE else round_rotation(multiply_matrices(self.R, other.R))
        return Frame(R, apply_matrix(self.R, other.p) + self.p)

    @property
    def inverse(self) -> Frame:
        """The frame from which it is seen, seen from it."""
        return Frame(self.R.T, -apply_matrix(self.R.T, self.p))


def make_frame(xyz: Iterable[float], rpy: Iterable[float]) -> Frame:
    """Return the frame at `xyz` [m], turned by roll, pitch and yaw [rad] as in a URDF."""
    rotations = (compute_rotation(axis, angle) for axis, angle in enumerate(rpy))
    roll, pitch, yaw = rotations
    return Frame(round_rotation(multiply_matrices(yaw, pitch, roll)), np.array(tuple(xyz)))


def compute_rotation(axis: int, angle: float) -> Array:
    """Return the rotation about an axis of the frame."""
    R: Array = build_rotations(axis, [angle])[0]
    return R


def build_rotations(axis: int, angles: Iterable[float]) -> Array:
    """Return rotations (K, 3, 3) about one axis."""
    # By `math`: NumPy's cosine may round differently on another processor.
    c, s = (np.array(list(map(f, angles))) for f in (math.cos, math.sin))
    R = np.tile(np.eye(3), (len(c), 1, 1))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R[:, i, i], R[:, i, j], R[:, j, i], R[:, j, j] = c, -s, s, c
    return round_rotation(R)


def compute_atan2(y: float, x: float) -> float:
    """Return the angle of (x, y), and 0 where both are 0 of whatever sign."""
    return 0.0 if y == 0.0 and x == 0.0 else math.atan2(y, x) + 0.0


def compute_rpy(R: Array) -> Array:
    """Return roll, pitch and yaw of Rz(yaw) Ry(pitch) Rx(roll)."""
    # The roll is that of Rz(-yaw) R, whatever the yaw is: near a pitch of a quarter turn roll and
    # yaw are ambiguous, but their product is still R.
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    yaw = compute_atan2(float(R[1, 0]), float(R[0, 0]))
    s, c = math.sin(yaw), math.cos(yaw)
    return np.array([math.atan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1]), pitch, yaw])


def round_rotation(R: Array) -> Array:
    """Return a rotation with entries that rounding moved off 0 and +-1 put back.

    The compiler folds zeros; the threshold is a few units of the last place.
    """
    nearest = np.rint(R)
    return np.where(np.abs(R - nearest) < 1e-15, nearest, R) + 0.0


def compute_cross(a: Array) -> Array:
    """Return the matrix (..., 3, 3) that takes the cross product with a (..., 3)."""
    out = np.zeros((*a.shape, 3))
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -z, y, -x
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = z, -y, x
    return out
