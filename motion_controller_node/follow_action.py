"""The action `follow_joint_trajectory`, available where control_msgs is installed.

Its callbacks never wait: a goal is a joint trajectory like those on the topic, and ends when the
motion controller reports its end. One thread therefore serves it and everything else.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from rclpy.task import Future

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.executor.goal_status import CANCELLED, GoalState, GoalStatus, Kind
from arm_emulator.motion.executor.goals import GOAL_TOLERANCE, PATH_TOLERANCE
from arm_emulator.motion.model.joint_reference import JointSetpoint
from arm_emulator.motion.trajectory.tolerances import Allowed, Tolerances
from arm_emulator.ros.node.barrier import guard_callback
from arm_emulator.ros.node.managed_node import ManagedNode

try:
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionServer, CancelResponse, GoalResponse
except ImportError:  # no wheel has it
    FollowJointTrajectory = None

NAME = "follow_joint_trajectory"

# Error codes of control_msgs/action/FollowJointTrajectory.
SUCCESSFUL = 0
INVALID_GOAL = -1
PATH_TOLERANCE_VIOLATED = -4
GOAL_TOLERANCE_VIOLATED = -5

_NANOSECONDS = 1e9


class FollowAction:
    """Serves the action.

    Args:
        node: node of the action.
        take: hands a goal over and returns the trajectory's number; a Refusal rejects the goal.
        cancel: aborts a trajectory by its number.
    """

    def __init__(
        self, node: ManagedNode, take: Callable[[Any], int], cancel: Callable[[int], None]
    ) -> None:
        self._take, self._cancel = take, cancel
        self._number = 0  # of the newest goal
        self._goals: dict[int, tuple[Any, Future]] = {}
        self._server = ActionServer(
            node,
            FollowJointTrajectory,
            NAME,
            execute_callback=self._execute_goal,
            goal_callback=guard_callback(
                node, NAME, self._handle_goal, lambda *_: GoalResponse.REJECT
            ),
            handle_accepted_callback=self._handle_accepted,
            cancel_callback=guard_callback(
                node, NAME, self._handle_cancel, lambda *_: CancelResponse.REJECT
            ),
        )

    def handle_report(self, report: GoalStatus) -> None:
        """End the goal whose final state is reported."""
        if report.kind is Kind.JOINT_TRAJECTORY and report.state.is_final:
            _, ended = self._goals.get(report.number, (None, None))
            if ended is not None and not ended.done():
                ended.set_result(report)

    def publish_feedback(
        self, stamp: Any, names: list[str], instruction: JointSetpoint, q: Array, v: Array
    ) -> None:
        """Publish how the arm follows the active goals."""
        for goal, ended in self._goals.values():
            if ended.done():
                continue
            feedback = FollowJointTrajectory.Feedback(joint_names=names)
            feedback.header.stamp = stamp
            speeds = 0.0 * q if instruction.v is None else instruction.v
            for point, positions, velocities in (
                (feedback.desired, instruction.q, speeds),
                (feedback.actual, q, v),
                (feedback.error, instruction.q - q, speeds - v),
            ):
                point.positions, point.velocities = positions.tolist(), velocities.tolist()
            goal.publish_feedback(feedback)

    def destroy_server(self) -> None:
        """Destroy the server."""
        self._server.destroy()

    def _handle_goal(self, goal: Any) -> GoalResponse:
        try:
            self._number = self._take(goal)
        except Refusal:
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _handle_accepted(self, goal: Any) -> None:
        self._goals[self._number] = goal, Future()
        goal.execute()

    def _handle_cancel(self, goal: Any) -> CancelResponse:
        self._cancel(self._find_number(goal))
        return CancelResponse.ACCEPT

    async def _execute_goal(self, goal: Any) -> Any:
        number = self._find_number(goal)
        report = await self._goals[number][1]
        del self._goals[number]
        code, words = make_result(report)
        if goal.is_cancel_requested:
            goal.canceled()
        elif code == 0:
            goal.succeed()
        else:
            goal.abort()
        return FollowJointTrajectory.Result(error_code=code, error_string=words)

    def _find_number(self, goal: Any) -> int:
        uuid = bytes(goal.goal_id.uuid)
        numbers = {
            bytes(handle.goal_id.uuid): number for number, (handle, _) in self._goals.items()
        }
        return numbers.get(uuid, 0)


def is_installed() -> bool:
    """Return whether control_msgs is installed."""
    return FollowJointTrajectory is not None


def read_tolerances(goal: Any, names: Sequence[str], default: Tolerances) -> Tolerances:
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
        path=_read_allowed(default.path, names, goal.path_tolerance),
        goal=_read_allowed(default.goal, names, goal.goal_tolerance),
        goal_time=max(0.0, seconds) if seconds else default.goal_time,
    )


def check_points(goal: Any) -> None:
    """Refuse a goal without points; on the topic a trajectory without points stops the arm."""
    if not goal.trajectory.points:
        rule, valid = "be some in a goal", "to cancel the goal that runs"
        raise Refusal("joint_trajectory", "points", rule, "none", valid)


def make_result(report: GoalStatus) -> tuple[int, str]:
    """Return error code and text for the final report of a goal.

    To cancel is no error.
    """
    if report.state is GoalState.REACHED:
        return SUCCESSFUL, "reached"
    words = f"{report.state.name.lower()}: {report.reason}"
    if report.state is GoalState.ABORTED and report.reason == CANCELLED:
        return SUCCESSFUL, words
    if report.state is GoalState.ABORTED and report.reason.startswith(PATH_TOLERANCE):
        return PATH_TOLERANCE_VIOLATED, words
    if report.state is GoalState.ABORTED and report.reason.startswith(GOAL_TOLERANCE):
        return GOAL_TOLERANCE_VIOLATED, words
    return INVALID_GOAL, words


def _read_allowed(default: Allowed, names: Sequence[str], tolerances: Sequence[Any]) -> Allowed:
    return default.change_values(
        names,
        {tolerance.name: (tolerance.position, tolerance.velocity) for tolerance in tolerances},
    )
