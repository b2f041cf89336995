"""Goals of the action FollowJointTrajectory: their tolerances and results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.executor.goal_status import CANCELLED, GoalStatus, State
from arm_emulator.motion.executor.goals import GOAL_TOLERANCE, PATH_TOLERANCE
from arm_emulator.motion.trajectory.tolerances import Allowed, Tolerances

# Error codes of control_msgs/action/FollowJointTrajectory.
SUCCESSFUL = 0
INVALID_GOAL = -1
PATH_TOLERANCE_VIOLATED = -4
GOAL_TOLERANCE_VIOLATED = -5

_NANOSECONDS = 1e9


def tolerances_of(goal: Any, names: Sequence[str], default: Tolerances) -> Tolerances:
    """Return the tolerances of a goal.

    Accelerations are not measured, so their tolerances are ignored.

    Args:
        goal: control_msgs/action/FollowJointTrajectory.Goal.
        names: of the arm's joints.
        default: for what it does not give.

    Raises:
        Refusal: an unknown joint, or a tolerance that is not valid.
    """
    time = goal.goal_time_tolerance
    seconds = int(time.sec) + int(time.nanosec) / _NANOSECONDS
    if seconds < 0.0 and seconds != -1.0:
        rule = "be >= 0 s, or -1 for any"
        raise Refusal("joint_trajectory", "goal_time_tolerance", rule, f"{seconds:g} s")
    return replace(
        default,
        path=_allowed(default.path, names, goal.path_tolerance),
        goal=_allowed(default.goal, names, goal.goal_tolerance),
        goal_time=max(0.0, seconds) if seconds else default.goal_time,
    )


def check_points(goal: Any) -> None:
    """Refuse a goal without points; on the topic a trajectory without points stops the arm.

    Raises:
        Refusal: it has none.
    """
    if not goal.trajectory.points:
        rule, valid = "be some in a goal", "to cancel the goal that runs"
        raise Refusal("joint_trajectory", "points", rule, "none", valid)


def result_of(report: GoalStatus) -> tuple[int, str]:
    """Return error code and text for the final report of a goal.

    To cancel is no error.
    """
    if report.state is State.REACHED:
        return SUCCESSFUL, "reached"
    words = f"{report.state.name.lower()}: {report.reason}"
    if report.state is State.ABORTED and report.reason == CANCELLED:
        return SUCCESSFUL, words
    if report.state is State.ABORTED and report.reason.startswith(PATH_TOLERANCE):
        return PATH_TOLERANCE_VIOLATED, words
    if report.state is State.ABORTED and report.reason.startswith(GOAL_TOLERANCE):
        return GOAL_TOLERANCE_VIOLATED, words
    return INVALID_GOAL, words


def _allowed(default: Allowed, names: Sequence[str], given: Sequence[Any]) -> Allowed:
    return default.changed(names, {one.name: (one.position, one.velocity) for one in given})
