"""The action `follow_joint_trajectory`, available where control_msgs is installed.

Its callbacks never wait: a goal is a joint trajectory like those on the topic, and ends when the
motion controller reports its end. One thread therefore serves it beside everything else.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.task import Future

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.executor.follow_joint_trajectory import result_of
from arm_emulator.motion.executor.goal_status import GoalStatus, Kind
from arm_emulator.motion.model.joint_reference import JointSetpoint
from arm_emulator.ros.node.barrier import guard
from arm_emulator.ros.node.managed_node import ManagedNode

try:
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionServer, CancelResponse, GoalResponse
except ImportError:  # no wheel has it
    FollowJointTrajectory = None

NAME = "follow_joint_trajectory"


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
            execute_callback=self._execute,
            goal_callback=guard(node, NAME, self._on_goal, lambda *_: GoalResponse.REJECT),
            handle_accepted_callback=self._on_accepted,
            cancel_callback=guard(node, NAME, self._on_cancel, lambda *_: CancelResponse.REJECT),
        )

    def hear(self, report: GoalStatus) -> None:
        """End the goal whose final state is reported."""
        if report.kind is Kind.JOINT_TRAJECTORY and report.state.final:
            _, ended = self._goals.get(report.number, (None, None))
            if ended is not None and not ended.done():
                ended.set_result(report)

    def feed_back(
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

    def close(self) -> None:
        """Destroy the server."""
        self._server.destroy()

    def _on_goal(self, goal: Any) -> GoalResponse:
        try:
            self._number = self._take(goal)
        except Refusal:
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _on_accepted(self, goal: Any) -> None:
        self._goals[self._number] = goal, Future()
        goal.execute()

    def _on_cancel(self, goal: Any) -> CancelResponse:
        self._cancel(self._number_of(goal))
        return CancelResponse.ACCEPT

    async def _execute(self, goal: Any) -> Any:
        number = self._number_of(goal)
        report = await self._goals[number][1]
        del self._goals[number]
        code, words = result_of(report)
        if goal.is_cancel_requested:
            goal.canceled()
        elif code == 0:
            goal.succeed()
        else:
            goal.abort()
        return FollowJointTrajectory.Result(error_code=code, error_string=words)

    def _number_of(self, goal: Any) -> int:
        wanted = bytes(goal.goal_id.uuid)
        return next(
            (
                number
                for number, (one, _) in self._goals.items()
                if bytes(one.goal_id.uuid) == wanted
            ),
            0,
        )


def installed() -> bool:
    """Return whether control_msgs is installed."""
    return FollowJointTrajectory is not None
