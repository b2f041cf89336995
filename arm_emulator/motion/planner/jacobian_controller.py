"""Joint targets from a tool target through the Jacobian: eq. (6) of the paper.

    q_target = q + w J(q)^-1 (X_target - X(q))

refreshed in every motion period.
"""

import math

import numpy as np
import numpy.typing as npt

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.coerce import coerce_kind
from arm_emulator.base.validation.number import Number
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.joint_reference import JointSetpoint, Reference
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.motion.model.pose import Pose

_SHARE = Number("weight", above=0.0, at_most=1.0)
_STEP_LIMIT = Number("step_limit", "rad", above=0.0)


class JacobianController:
    """Eq. (6) for the joints that move the tool; others stay where they are.

    The error ``X_target - X(q)`` is the translation from the tool to its target. In a pose task it
    has the rotation vector (logarithm), too. Both are along the world's axes at the tool.

    ``J^-1`` is the inverse of a square Jacobian; with more joints than task rows the least-norm
    one; with fewer the least-squares one.

    Near singular poses, and only there, it is damped. Let ``s`` be a singular value of J with its
    translations divided by the arm's reach, so that all entries are rad per rad. Let ``e`` be
    `singular_below`. Where ``s >= e``, ``1/s`` is used, exactly eq. (6). Where ``s < e``, that
    direction alone is damped with the factor of Maciejewski and Klein (1988) and Chiaverini (1997):

        s / (s^2 + m^2 (1 - (s/e)^2)),   m = e / 2

    which is continuous, 0 at s = 0 and nowhere above 1.16 / e.

    Args:
        kinematics: of the arm.
        weight: w of eq. (6), in (0, 1].
        step_limit: largest change of a joint per instruction [rad or m]; a larger step is shortened
            as a whole, so that its direction stays.
        singular_below: e of the damping rule [rad/rad].

    Raises:
        Refusal: a value that is not taken.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        weight: float = 0.5,
        step_limit: float = 0.2,
        singular_below: float = 0.02,
    ) -> None:
        if not isinstance(kinematics, Kinematics):
            raise Refusal("JacobianController", "kinematics", "be a Kinematics", kinematics)
        self.kinematics = kinematics
        self.weight = _SHARE.rename("weight").check_value("motion_controller", weight)
        self.step_limit = _STEP_LIMIT.check_value("motion_controller", step_limit)
        self.singular_below = _SHARE.rename("singular_below").check_value(
            "motion_controller", singular_below
        )
        self.notices: tuple[str, ...] = ()
        """Limit of the last `update`, as text; empty: none."""
        self.is_searching = False
        """Eq. (6) has one way only."""
        self.path_text = ""
        """Eq. (6) does not plan a way."""
        self.coming: Reference | None = None
        """Eq. (6) gives no speeds."""
        self.is_resting = True
        """Each answer of eq. (6) is a position of rest."""
        self.error = np.full(kinematics.rows, math.nan)
        """Tool error that the last `update` found, (rows,) [m, rad]; NaN before any."""

    def __repr__(self) -> str:
        return f"<JacobianController of {self.kinematics!r}>"

    def begin(self, q: npt.ArrayLike, v: npt.ArrayLike | None = None) -> None:
        """Begin at joint angles q (N,): eq. (6) has no state."""
        self.kinematics.vector(q)

    def begin_moving(self, now: Reference) -> None:
        """Begin with the joints' commanded motion."""
        self.begin(now.q)

    def retune(self, config: MotionConfig) -> None:
        """Continue with other parameters.

        Raises:
            Refusal: config is not a MotionConfig.
        """
        coerce_kind(
            config, MotionConfig, "JacobianController.retune", "config", "be a MotionConfig"
        )
        self.weight = config.weight
        self.step_limit = config.step_limit
        self.singular_below = config.singular_below

    def update(self, q: npt.ArrayLike, target: Pose) -> JointSetpoint:
        """Return the joint targets that bring the tool nearer to its target.

        Args:
            q: measured joint angles (N,) [rad or m].
            target: where the tool shall be.

        Returns:
            Joint targets, without speeds. `error` and `notices` describe how they were limited.

        Raises:
            Refusal: q of a wrong length, not finite or too large. Nothing has changed then.
            ArithmeticError: the robot description holds numbers that q_target cannot be computed
                from. Nothing has changed then.
        """
        q = self.kinematics.vector(q)
        with np.errstate(all="ignore"):  # the result is checked
            try:
                q_target, error, notices = self._compute_step(q, target)
            except np.linalg.LinAlgError:  # the Jacobian is not finite
                q_target = np.full_like(q, math.nan)
        if not np.isfinite(q_target).all():
            raise ArithmeticError(f"the joint targets of eq. (6) are not finite at q = {q}")
        self.error, self.notices = error, tuple(notices)
        return JointSetpoint(q_target)

    def _compute_step(self, q: Array, target: Pose) -> tuple[Array, Array, list[str]]:
        """Return q_target, the tool's error, and limits of the step as text."""
        error = self.kinematics.tool_error(q, target)
        scale = self.kinematics.scale
        moved = self.kinematics.to_tool
        J = self.kinematics.jacobian(q)[:, moved] * scale[:, None]
        U, s, Vt = np.linalg.svd(J, full_matrices=False)
        notices = []
        if s[-1] < self.singular_below:
            notices.append(
                f"near a singular pose, damped: singular value {s[-1]:.2g} is below "
                f"{self.singular_below:g}"
            )
        step = np.zeros(len(q))
        step[moved] = self.weight * (Vt.T @ (self._invert_values(s) * (U.T @ (scale * error))))
        longest = float(np.abs(step).max())
        if longest > self.step_limit:
            step *= self.step_limit / longest
            notices.append(f"step of {longest:.3g} rad shortened to {self.step_limit:g} rad")
        return self._limit_target(q, q + step, notices), error, notices

    def _invert_values(self, s: Array) -> Array:
        """Return 1/s, damped where s is small."""
        e = self.singular_below
        damping = np.where(s < e, (0.5 * e) ** 2 * (1.0 - (s / e) ** 2), 0.0)
        inverse: Array = s / (s**2 + damping)
        return inverse

    def _limit_target(self, q: Array, q_target: Array, notices: list[str]) -> Array:
        """Return `q_target` within the joint limits; a joint already outside may only come back."""
        lower, upper = self.kinematics.lower, self.kinematics.upper
        low, high = np.minimum(lower, q), np.maximum(upper, q)
        limited = np.clip(q_target, low, high)
        for j in np.flatnonzero(limited != q_target):
            notices.append(
                f"{self.kinematics.joint_names[j]} held at {limited[j]:.4g}: its limits are "
                f"[{lower[j]:.4g}, {upper[j]:.4g}]"
            )
        return limited
