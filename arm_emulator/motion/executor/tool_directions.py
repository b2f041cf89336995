"""Directions of tool and joints at one pose, and the joint speeds that a twist takes there.

The scaled Jacobian has singular values s_i, with directions u_i in the task and v_i in the joints.
They turn a twist into joint speeds:

    v = sum_i v_i (u_i' twist) / max(s_i, s_1 / stop)

What leads towards a singular pose by its own lost direction is slowed down from s_1 / slow on and
ends at s_1 / stop; what leads away from it, or past it in other directions, goes on.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from arm_emulator.base.arrays import Array
from arm_emulator.motion.executor.jog import JogStatus
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.kinematics import Kinematics

Brakes = Callable[[Array, float], float]
"""Share of joint speeds (N,) that comes to rest within a time at those speeds [s]."""
_NEAR = 4.0  # times the singular value at which a jog slows down: farther ones are left behind
_PROBE = 0.01  # rad, to find whether a direction leads towards a singular pose
_SIGNIFICANT = 0.05  # part of a twist: a direction with less of it does not slow the rest


@dataclass(frozen=True, eq=False)
class Speeds:
    """Joint speeds requested, and their permitted share."""

    v: Array
    """(N,) [rad/s or m/s]."""
    status: JogStatus = JogStatus.NO_WARNING


class ToolDirections:
    """Singular value decomposition of the scaled Jacobian at joint angles.

    Attributes:
        s: singular values, largest first (min(rows, N),) [rad/rad].
    """

    def __init__(self, kinematics: Kinematics, q: Array) -> None:
        self._kinematics, self._q = kinematics, q
        J = kinematics.scale[:, None] * kinematics.jacobian(q) * kinematics.joint_scale
        moved = kinematics.to_tool
        try:
            U, self.s, V = np.linalg.svd(J[:, moved])
        except np.linalg.LinAlgError:
            words = "the singular values of the Jacobian cannot be computed"
            raise ArithmeticError(words) from None
        self._U, self._V = U[:, : len(self.s)], V
        if not moved.all():  # the others are directions of their own, which do nothing to the tool
            self._V = np.zeros((len(q), len(q)))
            self._V[: len(V), moved], self._V[len(V) :, ~moved] = V, np.eye(len(q) - len(V))

    def project_idle(self, v: Array) -> Array:
        """Return the part of joint speeds (N,) that does not move the tool, to first order (N,)."""
        scale, V = self._kinematics.joint_scale, self._V[len(self.s) :]
        idle: Array = scale * (V.T @ (V @ (v / scale)))
        return idle

    def compute_speeds(
        self, twist: Array, config: MotionConfig, brakes: Brakes | None = None
    ) -> Speeds:
        """Return the joint speeds of a twist along the world's axes (6,).

        Args:
            twist: (6,) [m/s, rad/s].
            config: thresholds.
            brakes: what share of joint speeds (N,) can come to rest within a time at them [s];
                joints that move then rest before a singular pose. None: as quick as need be.
        """
        kinematics, s, V = self._kinematics, self.s, self._V
        scaled_twist = kinematics.scale * twist[: kinematics.rows]
        size = float(np.linalg.norm(scaled_twist))
        parts = self._U.T @ scaled_twist
        slow = s[0] / config.jog_lower_singularity_threshold
        stop = s[0] / config.jog_hard_stop_singularity_threshold
        share, status = 1.0, JogStatus.NO_WARNING
        for i in np.flatnonzero(s < slow):
            if abs(parts[i]) < 1e-9 * size or size == 0.0:
                continue
            ahead = self._q + kinematics.joint_scale * V[i] * math.copysign(_PROBE, parts[i])
            towards = ToolDirections(kinematics, ahead).s[i] < s[i]
            left = min(1.0, max(0.0, (s[i] - stop) / (slow - stop))) if towards else 1.0
            if abs(parts[i]) > _SIGNIFICANT * size:
                share = min(share, left)
                status = max(status, _find_status(towards, left))
            else:
                parts[i] *= left
        v = kinematics.joint_scale * (V[: len(s)].T @ (parts / np.maximum(s, stop)))
        if brakes is not None and share > 0.0 and s[-1] < _NEAR * slow:
            used = (np.abs(parts) > _SIGNIFICANT * size) & (s < _NEAR * slow)
            can = self._find_stopping_share(v, stop, used, brakes)
            if can < share:
                share = can
                status = max(status, JogStatus.DECELERATE_FOR_APPROACHING_SINGULARITY)
        return Speeds(share * v, status)

    def _find_stopping_share(
        self, v: Array, stop: float, used: npt.NDArray[np.bool_], brakes: Brakes
    ) -> float:
        """Return the share of v (N,) from which no singular value in use falls below `stop`."""
        fastest = float(np.abs(v / self._kinematics.joint_scale).max())
        if not used.any() or fastest == 0.0:
            return 1.0
        probe = _PROBE / fastest
        falls = (self.s - ToolDirections(self._kinematics, self._q + probe * v).s)[used] / probe
        if (falls <= 0.0).all():
            return 1.0
        left = np.maximum(self.s[used] - stop, 0.0)[falls > 0.0] / falls[falls > 0.0]
        return brakes(v, float(left.min()))


def _find_status(towards: bool, left: float) -> JogStatus:
    if not towards:
        return JogStatus.DECELERATE_FOR_LEAVING_SINGULARITY
    if left > 0.0:
        return JogStatus.DECELERATE_FOR_APPROACHING_SINGULARITY
    return JogStatus.HALT_FOR_SINGULARITY
