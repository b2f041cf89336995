"""Joint targets from a tool target through the Jacobian: eq. (6) of the paper.

    q_target = q + w J(q)^-1 (X_target - X(q))

refreshed in every motion period. Kinematics by Pinocchio.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from motion_controller_node.kinematics_model import JOINT, LINK, link_names, whole_model
from motion_controller_node.pose import Pose
from words.bound import POSITION, TOOL_POSITION, Bound
from words.refusal import Refusal

__all__ = ["JacobianController", "Pose"]

FloatArray = npt.NDArray[np.float64]

_Q = POSITION.named("q")
_REACH = TOOL_POSITION.named("the length of the arm")
_TARGET_ROTATION = Bound("the rotation", "", 1.001)  # no entry is larger, but for rounding

POSITION_ROWS = 3
POSE_ROWS = 6


class JacobianController:
    """Eq. (6) for any serial arm.

    The error ``X_target - X(q)`` is the translation and, in a pose task, the rotation vector
    (logarithm) from the tool to its target, both along the world's axes at the tool.

    ``J^-1`` is the inverse of a square Jacobian; with more joints than task rows the least-norm
    one; with fewer the least-squares one.

    Near singular poses, and only there, it is damped. Let ``s`` be a singular value of J with its
    translations divided by the arm's reach (so that all entries are rad per rad), and ``e`` be
    `singular_below`. Where ``s >= e``, ``1/s`` is used, exactly eq. (6). Where ``s < e``, that
    direction alone is damped with the factor of Maciejewski and Klein (1988) and Chiaverini (1997):

        s / (s^2 + m^2 (1 - (s/e)^2)),   m = e / 2

    which is continuous, 0 at s = 0 and nowhere above 1.16 / e.

    Args:
        urdf_xml: the robot description. Moving joints that are not in `joint_names` stay at their
            neutral position.
        joint_names: the joints commanded, in the order of all arrays.
        tool: link (or any frame of the URDF) that is the tool.
        weight: w of eq. (6), in (0, 1].
        task: "position", "pose", or "auto": pose from 6 joints on.
        step_limit: largest change of a joint per instruction [rad or m]; a larger step is shortened
            as a whole, so that its direction stays.
        singular_below: e of the damping rule [rad/rad].

    Raises:
        Refusal: a description, name or value that is not taken.
    """

    def __init__(
        self,
        urdf_xml: str,
        joint_names: Sequence[str],
        tool: str,
        weight: float = 0.5,
        task: str = "auto",
        step_limit: float = 0.2,
        singular_below: float = 0.02,
    ) -> None:
        self.joint_names = tuple(joint_names)
        self.tool = tool
        self.weight = _within(weight, "weight", "be in (0, 1]", 1.0)
        self.step_limit = _within(step_limit, "step_limit", "be a number > 0 rad", math.inf)
        self.singular_below = _within(singular_below, "singular_below", "be in (0, 1]", 1.0)
        self.rows = _rows(task, len(self.joint_names))
        self.model = _model(urdf_xml, self.joint_names, tool)
        self._data = self.model.createData()
        self._joints = [
            self.model.joints[self.model.getJointId(JOINT + n)] for n in self.joint_names
        ]
        self._columns = [joint.idx_v for joint in self._joints]
        self._frame = _frame(self.model, tool)
        self._lower, self._upper = self._limits()
        self.reach = self._reach()
        """Length of the chain from its first joint to the tool [m]."""
        _REACH.check("robot_description", [self.reach])
        neutral = pin.neutral(self.model)
        pin.framesForwardKinematics(self.model, self._data, neutral)
        R_WT, p_WT = self._data.oMf[self._frame].rotation, self._data.oMf[self._frame].translation
        TOOL_POSITION.named("tool").check("robot_description", p_WT.tolist())
        _TARGET_ROTATION.check("robot_description", np.ravel(R_WT).tolist())
        self.base = _base(self.model)
        """Link that stands in the world, in whose frame poses are given."""
        self._scale = np.ones(self.rows)
        self._scale[:POSITION_ROWS] = 1.0 / self.reach
        self.notices: tuple[str, ...] = ()
        """What limited the last `update`, in words; empty: nothing did."""
        self.error = np.full(self.rows, math.nan)
        """Tool error that the last `update` found, (rows,) [m, rad]; NaN before any."""

    def forward(self, q: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return where the tool is: ``R_WT`` (3, 3) and ``p_WT`` (3,) [m]."""
        pin.framesForwardKinematics(self.model, self._data, self._configuration(q))
        placement = self._data.oMf[self._frame]
        return placement.rotation.copy(), placement.translation.copy()

    def jacobian(self, q: npt.ArrayLike) -> FloatArray:
        """Return J(q), (rows, N) [m/rad, rad/rad], along the world's axes at the tool."""
        J = pin.computeFrameJacobian(
            self.model,
            self._data,
            self._configuration(q),
            self._frame,
            pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
        )
        J = np.reshape(J, (POSE_ROWS, -1))  # of a single joint it comes as a vector
        rows: FloatArray = J[: self.rows, self._columns]
        return rows

    def tool_error(self, q: npt.ArrayLike, target: Pose) -> FloatArray:
        """Return ``X_target - X(q)``, (rows,) [m, rad]."""
        R_WT, p_WT = self.forward(q)
        error = target.p_WT - p_WT
        if self.rows == POSITION_ROWS:
            return error
        return np.concatenate([error, pin.log3(target.R_WT @ R_WT.T)])

    def singular_values(self, q: npt.ArrayLike) -> FloatArray:
        """Return the singular values on which the damping rule looks, largest first."""
        scaled = self.jacobian(q) * self._scale[:, None]
        return np.asarray(np.linalg.svd(scaled, compute_uv=False), dtype=np.float64)

    def update(self, q: npt.ArrayLike, target: Pose) -> FloatArray:
        """Return the joint targets that bring the tool nearer to its target.

        Args:
            q: measured joint angles (N,) [rad or m].
            target: where the tool shall be.

        Returns:
            q_target (N,) [rad or m]. `error` and `notices` describe how it was limited.

        Raises:
            Refusal: q of a wrong length, not finite or too large. Nothing has changed then.
            ArithmeticError: the robot description holds numbers that q_target cannot be computed
                from. Nothing has changed then.
        """
        q = self._vector(q)
        with np.errstate(all="ignore"):  # what came of it is checked
            try:
                q_target, error, notices = self._step(q, target)
            except np.linalg.LinAlgError:  # the Jacobian is not finite
                q_target = np.full_like(q, math.nan)
        if not np.isfinite(q_target).all():
            raise ArithmeticError(f"the joint targets of eq. (6) are not finite at q = {q}")
        self.error, self.notices = error, tuple(notices)
        return q_target

    def _step(self, q: FloatArray, target: Pose) -> tuple[FloatArray, FloatArray, list[str]]:
        """Return q_target, the tool's error, and what limited the step in words."""
        error = self.tool_error(q, target)
        U, s, Vt = np.linalg.svd(self.jacobian(q) * self._scale[:, None], full_matrices=False)
        notices = []
        if s[-1] < self.singular_below:
            notices.append(
                f"near a singular pose, damped: singular value {s[-1]:.2g} is below "
                f"{self.singular_below:g}"
            )
        step = self.weight * (Vt.T @ (self._inverse(s) * (U.T @ (self._scale * error))))
        longest = float(np.abs(step).max())
        if longest > self.step_limit:
            step *= self.step_limit / longest
            notices.append(f"step of {longest:.3g} rad shortened to {self.step_limit:g} rad")
        return self._within_limits(q, q + step, notices), error, notices

    def _inverse(self, s: FloatArray) -> FloatArray:
        """Return 1/s, damped where s is small."""
        e = self.singular_below
        damping = np.where(s < e, (0.5 * e) ** 2 * (1.0 - (s / e) ** 2), 0.0)
        inverse: FloatArray = s / (s**2 + damping)
        return inverse

    def _within_limits(self, q: FloatArray, q_target: FloatArray, notices: list[str]) -> FloatArray:
        """Return `q_target` within the joint limits; a joint already outside may only come back."""
        low, high = np.minimum(self._lower, q), np.maximum(self._upper, q)
        limited = np.clip(q_target, low, high)
        for j in np.flatnonzero(limited != q_target):
            notices.append(
                f"{self.joint_names[j]} held at {limited[j]:.4g}: its limits are "
                f"[{self._lower[j]:.4g}, {self._upper[j]:.4g}]"
            )
        return limited

    def _vector(self, q: npt.ArrayLike) -> FloatArray:
        return _Q.vector("motion_controller", q, len(self.joint_names))

    def _configuration(self, q: npt.ArrayLike) -> FloatArray:
        """Return Pinocchio's configuration: a continuous joint has cos and sin there."""
        configuration: FloatArray = pin.neutral(self.model)
        for joint, angle in zip(self._joints, self._vector(q), strict=True):
            if joint.nq == 2:
                configuration[joint.idx_q : joint.idx_q + 2] = math.cos(angle), math.sin(angle)
            else:
                configuration[joint.idx_q] = angle
        return configuration

    def _limits(self) -> tuple[FloatArray, FloatArray]:
        """Return the joint limits of the URDF, (N,) each; a continuous joint has none."""
        bounds = [
            (-math.inf, math.inf)
            if joint.nq == 2
            else (
                self.model.lowerPositionLimit[joint.idx_q],
                self.model.upperPositionLimit[joint.idx_q],
            )
            for joint in self._joints
        ]
        lower, upper = np.array(bounds, dtype=np.float64).T
        return lower, upper

    def _reach(self) -> float:
        frame = self.model.frames[self._frame]
        length = math.hypot(*frame.placement.translation)
        joint = frame.parentJoint
        while self.model.parents[joint] > 0:
            length += math.hypot(*self.model.jointPlacements[joint].translation)
            joint = self.model.parents[joint]
        return length or 1.0


def moving_joints(urdf_xml: str) -> tuple[str, ...]:
    """Return the names of a robot description's moving joints, base to tool.

    Raises:
        Refusal: not a robot description, or one that Pinocchio does not take.
    """
    return _moving(whole_model(urdf_xml))


def _within(value: Any, quantity: str, rule: str, high: float) -> float:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not math.isfinite(value) or not 0.0 < value <= high:
        raise Refusal("motion_controller", quantity, rule, value)
    return float(value)


def _rows(task: str, joints: int) -> int:
    """Return the number of task rows."""
    tasks = {
        "auto": POSE_ROWS if joints >= POSE_ROWS else POSITION_ROWS,
        "position": POSITION_ROWS,
        "pose": POSE_ROWS,
    }
    if task not in tasks:
        raise Refusal("motion_controller", "task", "be known", task, ", ".join(tasks))
    return tasks[task]


def _moving(model: Any) -> tuple[str, ...]:
    return tuple(name.removeprefix(JOINT) for name in list(model.names)[1:])


def _model(urdf_xml: str, joint_names: tuple[str, ...], tool: str) -> Any:
    """Return the Pinocchio model whose moving joints are exactly `joint_names`."""
    model = whole_model(urdf_xml, tool)
    moving = _moving(model)
    for name in joint_names:
        if name not in moving:
            raise Refusal(
                "motion_controller",
                "joint_names",
                "be moving joints of the robot description",
                name,
                ", ".join(moving),
            )
    if not joint_names or len(set(joint_names)) != len(joint_names):
        raise Refusal("motion_controller", "joint_names", "be different names", joint_names)
    locked = [model.getJointId(JOINT + name) for name in moving if name not in joint_names]
    model = pin.buildReducedModel(model, locked, pin.neutral(model))
    for name in joint_names:
        if model.joints[model.getJointId(JOINT + name)].nv != 1:
            raise Refusal("motion_controller", name, "have one degree of freedom", "more")
    return model


def _frame(model: Any, tool: str) -> int:
    """Return the index of the link (or other frame) `tool`."""
    for name, kind in (
        (LINK + tool, pin.FrameType.BODY),
        (JOINT + tool, pin.FrameType.FIXED_JOINT),
    ):
        if model.existFrame(name, kind):
            return int(model.getFrameId(name, kind))
    raise Refusal(
        "motion_controller",
        "tool",
        "be a link of the robot description",
        tool,
        ", ".join(link_names(model)),
    )


def _base(model: Any) -> str:
    """Return the name of the root link."""
    return link_names(model)[0]
