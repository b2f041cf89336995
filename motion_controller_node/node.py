"""ROS node `motion_controller`: tool targets and joint states in, joint targets out."""

from __future__ import annotations

from array import array
from collections import deque

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from arm_emulator.joint_order import JointOrder
from arm_emulator.node_shell import (
    COMMAND_QOS,
    DESCRIPTION_QOS,
    NANOSECONDS,
    STATE_SUB_QOS,
    Diagnostics,
    declare_parameters,
    nanoseconds_of,
    run_node,
)
from arm_emulator.refusal import Refusal
from motion_controller_node.jacobian import FloatArray, JacobianController
from motion_controller_node.motion_config import MotionConfig
from motion_controller_node.pose import Pose


class MotionControllerNode(Node):
    """The motion controller as a ROS node.

    It answers the joint states at every multiple of its period with joint targets of the same time
    stamp: where the arm stood at first, until a tool target holds; then eq. (6).
    """

    def __init__(self) -> None:
        super().__init__("motion_controller")
        self._config = declare_parameters(self, MotionConfig)
        self._period_ns = round(self._config.period * NANOSECONDS)
        self._diagnostics = Diagnostics(self, "motion controller")
        self._diagnostics.values["tool targets"] = 0
        self._urdf: str | None = None
        self._controller: JacobianController | None = None
        self._start_over()
        self._targets = self.create_publisher(JointState, "joint_targets", COMMAND_QOS)
        self.create_subscription(String, "robot_description", self._on_description, DESCRIPTION_QOS)
        self.create_subscription(JointState, "joint_states", self._on_joint_states, STATE_SUB_QOS)
        self.create_subscription(PoseStamped, "tool_target", self._on_tool_target, COMMAND_QOS)

    def close(self) -> None:
        """Nothing to let go of."""

    def _start_over(self) -> None:
        self._answer: JointState | None = None
        self._hold: FloatArray | None = None
        self._tool_target: Pose | None = None
        self._coming: deque[tuple[int, Pose]] = deque()

    def _on_description(self, message: String) -> None:
        self._urdf, self._controller = message.data, None

    def _on_tool_target(self, message: PoseStamped) -> None:
        p, o = message.pose.position, message.pose.orientation
        try:
            if message.header.frame_id not in ("", "world", *self._root()):
                raise Refusal(
                    "tool_target",
                    "header.frame_id",
                    "be the arm's base",
                    message.header.frame_id,
                    ", ".join(("world", *self._root())),
                )
            pose = Pose.from_quaternion((p.x, p.y, p.z), (o.x, o.y, o.z, o.w))
        except Refusal as reason:
            self._diagnostics.refuse("tool_target", reason)
            return
        # In the order of their times; of two with the same time the newer wins.
        self._coming.append((nanoseconds_of(message.header.stamp), pose))
        self._coming = deque(sorted(self._coming, key=lambda item: item[0]))
        accepted = self._diagnostics.values["tool targets"]
        assert isinstance(accepted, int)
        self._diagnostics.values["tool targets"] = accepted + 1
        self._diagnostics.publish()

    def _on_joint_states(self, message: JointState) -> None:
        now = nanoseconds_of(message.header.stamp)
        if now % self._period_ns != 0:
            return
        if self._answer is not None and now <= nanoseconds_of(self._answer.header.stamp):
            if message.header.stamp == self._answer.header.stamp:
                self._targets.publish(self._answer)  # somebody came late or lost it
                return
            self._start_over()
        try:
            controller = self._ready_controller(message)
            if controller is None:
                return
            order = JointOrder("joint_states", controller.joint_names)
            q = order.arrange(message.name, message.position, "position", "rad")
            q_target = self._instruct(controller, now, q)
        except Refusal as reason:
            self._diagnostics.refuse("joint_states", reason)
            return
        answer = JointState(name=controller.joint_names)
        answer.header.stamp = message.header.stamp
        answer.position = array("d", q_target.tobytes())
        self._answer = answer
        self._targets.publish(answer)

    def _instruct(self, controller: JacobianController, now: int, q: FloatArray) -> FloatArray:
        while self._coming and self._coming[0][0] <= now:
            self._tool_target = self._coming.popleft()[1]
        if self._tool_target is None:
            if self._hold is None:
                self._hold = q
            self._diagnostics.ok("holding, no tool target yet")
            return self._hold
        q_target = controller.update(q, self._tool_target)
        if controller.notices:
            self._diagnostics.warn("; ".join(controller.notices))
        else:
            self._diagnostics.ok("moving the tool to its target")
        self._diagnostics.values["tool error [m]"] = f"{np.linalg.norm(controller.error[:3]):.2e}"
        return q_target

    def _ready_controller(self, message: JointState) -> JacobianController | None:
        if self._controller is None:
            if self._urdf is None:
                self._diagnostics.warn("waiting for robot_description")
                return None
            self._controller = JacobianController(
                self._urdf, list(message.name), **self._config.controller_arguments()
            )
        return self._controller

    def _root(self) -> tuple[str, ...]:
        return (self._controller.base,) if self._controller is not None else ()


def main() -> None:
    """Entry point of `ros2 run arm_emulator motion_controller_node`."""
    run_node(MotionControllerNode)


if __name__ == "__main__":
    main()
