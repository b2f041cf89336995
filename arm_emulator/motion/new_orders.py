"""Orders of what is requested, with the limits and tolerances of the parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.controller import Controller
from arm_emulator.motion.joint_trajectory import JointTrajectory, TrajectoryPoint
from arm_emulator.motion.kinematics import Kinematics
from arm_emulator.motion.laws import Laws, joint_limits, tool_limits
from arm_emulator.motion.motion_config import MotionConfig
from arm_emulator.motion.orders import PathOrder, TrajectoryOrder
from arm_emulator.motion.pose import Pose
from arm_emulator.motion.tolerances import Allowed, Tolerances
from arm_emulator.motion.tool_path import ToolPath


def trajectory_order(
    controller: Controller | None,
    config: MotionConfig,
    names: Sequence[str],
    points: Sequence[TrajectoryPoint],
    stamp_ns: int,
    tolerances: Callable[[Tolerances], Tolerances],
) -> TrajectoryOrder:
    """Return the order for a joint trajectory; arguments as those of `Instructor.add_trajectory`.

    Raises:
        Refusal: see `JointTrajectory`, or no arm.
    """
    kinematics = _known(controller, "joint_trajectory")
    joints, limits = kinematics.joint_names, joint_limits(kinematics, config)
    trajectory = JointTrajectory(joints, limits, names, points, stamp_ns, config.may_end_moving)
    default = Tolerances(
        Allowed.alike(len(joints), config.path_tolerance),
        Allowed.alike(len(joints), config.goal_tolerance),
        config.goal_time,
    )
    return TrajectoryOrder(trajectory, tolerances(default))


def path_order(
    controller: Controller | None,
    config: MotionConfig,
    poses: Sequence[Pose],
    stamp_ns: int,
    times_ns: Sequence[int] | None,
) -> PathOrder:
    """Return the order for a tool path; arguments as those of `Instructor.add_path`.

    Raises:
        Refusal: see `ToolPath`, or no arm.
    """
    kinematics = _known(controller, "tool_path")
    turning = kinematics.turns_tool
    # A free orientation must not take time.
    level = [one if turning else Pose(one.p_WT, np.eye(3)) for one in poses]
    limits, arcs, blend = tool_limits(config), config.path_arcs, config.path_blend
    return PathOrder(ToolPath(level, limits, stamp_ns, times_ns, arcs, blend))


def stop_order(laws: Laws) -> TrajectoryOrder:
    """Return the order to come to rest."""
    names = laws.controller.kinematics.joint_names
    anything = Allowed.alike(len(names), 0.0)
    limits = joint_limits(laws.controller.kinematics, laws.config)
    return TrajectoryOrder(JointTrajectory(names, limits, (), ()), Tolerances(anything, anything))


def _known(controller: Controller | None, where: str) -> Kinematics:
    if controller is None:
        raise Refusal(where, "the message", "come after the robot description", "none so far")
    return controller.kinematics
