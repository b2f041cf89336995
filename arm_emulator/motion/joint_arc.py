"""Curves between two configurations on which the tool does not go past its end.

On the joints' line the tool may go past the place where it comes to rest, and come back. An arc of
the joints beside that line comes to the same end from before it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from arm_emulator.motion.arm_tree import ArmTree
from arm_emulator.motion.joint_curve import JointCurve
from arm_emulator.motion.spread import spread

FloatArray = npt.NDArray[np.float64]

QUIETLY_PAST = 1e-3  # m past its end, that a curve of the joints may take the tool without a word
_TRIED = ((1, 256), (2, 512))  # control points between the ends, and sets of them
_TOGETHER = 64  # sets
_ASIDE = 2.0  # rad (or m per reach) that they lie beyond both ends at most
_LOOKS, _LOOKS_AGAIN = np.linspace(0.0, 1.0, 33), np.linspace(0.0, 1.0, 257)
# From control points of Bezier's curves to coefficients of powers.
_POWERS = {
    1: np.array([[1.0, 0.0, 0.0], [-2.0, 2.0, 0.0], [1.0, -2.0, 1.0]]),
    2: np.array(
        [[1.0, 0.0, 0.0, 0.0], [-3.0, 3.0, 0.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1.0, 3.0, -3.0, 1.0]]
    ),
}


def past_end(arm: ArmTree, curve: JointCurve) -> float:
    """Return how far the tool goes past its end, along the line to it, on a curve [m].

    A tool that comes to rest where it began has no such line: 0.
    """
    return float(_past(arm, curve.derivatives(_LOOKS_AGAIN)[0][None])[0])


def joint_arc(arm: ArmTree, start: FloatArray, end: FloatArray) -> JointCurve | None:
    """Return a curve on which the tool goes `QUIETLY_PAST` its end at most; None: none was found.

    Bezier's curves with control points all over the limits, those nearest to the joints' line
    first: they lie within the limits, as their control points do.

    Args:
        arm: the arm.
        start: joints at the begin (N,).
        end: joints at the end (N,).
    """
    kinematics = arm.kinematics
    low, high = np.minimum(start, end), np.maximum(start, end)
    aside = _ASIDE * kinematics.joint_scale
    low = np.maximum(np.minimum(kinematics.lower, low), low - aside)
    high = np.minimum(np.maximum(kinematics.upper, high), high + aside)
    for between, count in _TRIED:
        parts = spread(count, between * len(start)).reshape(count, between, -1)
        share = np.arange(1.0, between + 1.0)[:, None] / (between + 1)
        line = start + share * (end - start)
        points = np.where(kinematics.to_tool, low + parts * (high - low), line)
        far = np.square((points - line) / kinematics.joint_scale).sum(axis=(1, 2))
        points = points[np.argsort(far, kind="stable")]
        for first in range(0, count, _TOGETHER):
            some = points[first : first + _TOGETHER]
            ends = [np.broadcast_to(q, (len(some), 1, len(q))) for q in (start, end)]
            coefficients = _POWERS[between] @ np.concatenate([ends[0], some, ends[1]], axis=1)
            powers = np.vander(_LOOKS, between + 2, increasing=True)
            for k in np.flatnonzero(_past(arm, powers @ coefficients) <= QUIETLY_PAST):
                curve = JointCurve(np.array([0.0, 1.0]), coefficients[k][None])
                if past_end(arm, curve) <= QUIETLY_PAST:
                    return curve
    return None


def _past(arm: ArmTree, q: FloatArray) -> FloatArray:
    """Return how far the tool goes past its end on curves (K, looks, N), (K,) [m]."""
    p = arm.forward(q.reshape(-1, q.shape[-1]))[0].reshape(*q.shape[:2], 3)
    line = p[:, -1] - p[:, 0]
    length = np.sqrt(np.einsum("ki,ki->k", line, line))
    along = np.einsum("kli,ki->kl", p - p[:, -1:], line).max(axis=1)
    return np.asarray(np.where(length > QUIETLY_PAST, along / np.maximum(length, 1e-9), 0.0))
