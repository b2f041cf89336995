"""The tool's distance from its target at rest, by encoders and gears."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from arm_emulator.base.arrays import Array
from arm_emulator.motion.model.kinematics import POSITION_ROWS
from arm_emulator.motion.model.pose import Pose
from arm_emulator.motion.planner.jacobian_controller import JacobianController
from arm_emulator.motion.planner.tool_controller import Controller


@dataclass(frozen=True, eq=False)
class PredictedResidual:
    """Deviation ``X_target - X`` of the true tool at rest: ``wind_up`` plus or minus ``encoder``.

    Rows as the task: translation [m], then rotation [rad].
    """

    encoder: Array
    """Largest deviation of either sign that the encoders' resolution leaves, (rows,), >= 0."""
    wind_up: Array
    """Deviation by the gears' wind-up, with its sign, (rows,); 0 where it was not asked for."""

    @property
    def total(self) -> Array:
        """Bound on the size of the whole deviation, (rows,)."""
        return self.encoder + np.abs(self.wind_up)


def predict_residual(
    controller: Controller,
    q: npt.ArrayLike,
    count_angle: npt.ArrayLike,
    wind_up: npt.ArrayLike | None = None,
    held_within: float = 0.5,
) -> PredictedResidual:
    """Bound the deviation of the true tool from its target at rest.

    Let d_j be `count_angle`, the angle of one count at the link, and h be `held_within`.

    1. The servo shows the middle of the count in which the motor stands, so motor and measured
       angle differ by at most d_j / 2.
    2. At rest the servo holds the measured angle within h d_j of its target. Our servo, integral
       action with no correction within the count, has h = 1/2.
    3. So eq. (6) has come to rest when ``|w J^-1 e|_j <= h d_j`` in every joint, e being the error
       of the measured tool: the next target lies in the count where the motor stands already. With
       ``e = J J^-1 e`` (away from singular poses, joints enough for the task)

           |e|_i <= sum_j |J_ij| h d_j / w.

    4. The true tool lies ``J dq`` from the measured one, ``|dq_j| <= d_j / 2`` by 1. Together

           |X_target - X|_i <= sum_j |J_ij| d_j (h / w + 1/2) + second order,

       the last is ``S (S / 2 + W)``, times the arm's reach in the rows of translation. Here
       ``S = sum_j d_j (h / w + 1/2)``, and the wind-up is ``W = sum_j |T_j / Kg_j|``: no second
       derivative of a chain of revolute joints is larger.

    The reference of `TargetPlanner` does not depend on what is measured: it rests at the target (or
    at the reachable point nearest to it), and 3. is ``|e|_i <= sum_j |J_ij| h d_j``, as with w = 1.
    That holds at singular poses, too.

    With w = 1/2 this is 1.5 counts in every joint, with `TargetPlanner` 1. Both can be met, so
    it is tight for a single joint; several joints seldom err all to the worst side at once.

    A motor without static friction may stand on the edge between two counts and cross it now and
    then. Measured from the neighbouring count, ``x = J^-1 e`` changes by one count. The target
    moves over, too, only if ``w x + (1 - w) d > d / 2``; then the new ``|x - d|`` is again at most
    d / (2 w). So crossing does not leave the bound, except for the motor's overshoot past the edge.
    This overshoot is below 0.01 counts with the scene three_axis, and below 0.1 with ur5 and panda.

    An encoder on the motor does not see the gear's wind-up u between motor and link, T / Kg of a
    linear gear. It displaces the tool by ``X(q + u) - X(q)``, for example by the arm's weight.
    No weight w and no number of instructions takes that away.

    Args:
        controller: of the arm; w is its weight where it is that of eq. (6).
        q: link angles at rest, true ones where wind-up is asked for, (N,) [rad].
        count_angle: link angle of one encoder count, (N,) [rad].
        wind_up: u of the gears at rest, seen at the link, (N,) [rad]; None: no gear winds up.
        held_within: h, how near the servo holds the measured angle to its target at rest [counts].

    Returns:
        Bounds in the rows of the task. With fewer joints than rows, of the reachable part of e.

    With eq. (6) no bound exists at a singular pose.
    """
    kinematics, q = controller.kinematics, np.asarray(q, dtype=float)
    deflection = np.zeros_like(q) if wind_up is None else np.asarray(wind_up, dtype=float)
    times = 1.0 / controller.weight if isinstance(controller, JacobianController) else 1.0
    off = np.asarray(count_angle) * (held_within * times + 0.5)
    second = np.full(kinematics.rows, off.sum() * (0.5 * off.sum() + np.abs(deflection).sum()))
    second[:POSITION_ROWS] *= kinematics.reach
    R_WT, p_WT = kinematics.forward(q + deflection)
    return PredictedResidual(
        encoder=np.abs(kinematics.jacobian(q)) @ off + second,
        wind_up=kinematics.tool_error(q, Pose(p_WT, R_WT)),
    )
