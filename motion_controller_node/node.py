"""ROS node `motion_controller`: tool targets and joint states in, joint targets out."""

from __future__ import annotations

if __name__ == "__main__":  # before what takes long to import
    from ros_shell.ctrl_c import end_at_once

    end_at_once(0)

from array import array
from collections.abc import Mapping
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from motion_controller_node.controller import Controller, controller_for
from motion_controller_node.instructor import Instructor
from motion_controller_node.kinematics import moving_joints
from motion_controller_node.motion_config import MotionConfig
from motion_controller_node.pose import Pose
from ros_shell.doubles import Doubles
from ros_shell.node_shell import (
    COMMAND_QOS,
    COMMAND_SUB_QOS,
    DESCRIPTION_QOS,
    NANOSECONDS,
    STATE_SUB_QOS,
    Diagnostics,
    accept_changes,
    declare_parameters,
    nanoseconds_of,
    refuse_other_parameters,
    replaced,
    run_node,
    time_of,
)
from words.bound import POSITION
from words.joint_order import JointOrder
from words.refusal import Refusal


class MotionControllerNode(Node):
    """The motion controller as a ROS node.

    It answers the joint states at every multiple of its period with joint targets of the same time
    stamp: where the arm stood at first, until a tool target holds; then those of the control law.
    """

    def __init__(self) -> None:
        super().__init__("motion_controller", automatically_declare_parameters_from_overrides=True)
        self._config = declare_parameters(self, MotionConfig)
        refuse_other_parameters(self, self._config)
        accept_changes(self, self._changed, self._take_parameters)
        self._period_ns = round(self._config.period * NANOSECONDS)
        self._diagnostics = Diagnostics(self, "motion controller")
        self._doubles = Doubles(
            self,
            self._diagnostics,
            "motion controller",
            "joint_targets",
            "the servo takes the first targets that come",
        )
        self._diagnostics.values["tool targets"] = 0
        self._diagnostics.warn("waiting for robot_description")
        self._urdf = ""
        self._controller: Controller | None = None
        self._instructor = Instructor()
        self._answer: JointState | None = None
        self._targets = self.create_publisher(JointState, "joint_targets", COMMAND_QOS)
        self.create_subscription(String, "robot_description", self._on_description, DESCRIPTION_QOS)
        self.create_subscription(JointState, "joint_states", self._on_joint_states, STATE_SUB_QOS)
        self.create_subscription(PoseStamped, "tool_target", self._on_tool_target, COMMAND_SUB_QOS)
        self.create_service(Trigger, "~/reset", self._on_reset)

    def _changed(self, changes: Mapping[str, Any]) -> MotionConfig:
        return replaced(self, self._config, changes)

    def _take_parameters(self, config: MotionConfig) -> None:
        """Work with other parameters from the next motion period on."""
        self._config = config
        if self._controller is not None:
            self._controller.retune(config)

    def close(self) -> None:
        """Nothing to release."""

    def _start_over(self) -> None:
        self._answer = None
        self._instructor.start_over()

    def _on_description(self, message: String) -> None:
        if self._controller is not None and message.data == self._urdf:
            return
        try:
            controller = controller_for(message.data, moving_joints(message.data), self._config)
        except Refusal as reason:
            self._diagnostics.refuse("robot_description", reason)
            return
        if self._controller is not None:  # targets for another arm
            self._start_over()
        self._urdf, self._controller = message.data, controller
        self._order = JointOrder("joint_states", controller.kinematics.joint_names)
        self._diagnostics.ok("waiting for joint_states")

    def _on_tool_target(self, message: PoseStamped) -> None:
        p, o = message.pose.position, message.pose.orientation
        try:
            time_ns = time_of("tool_target", message.header.stamp)
            bases = list(dict.fromkeys(("world", *self._root())))
            if message.header.frame_id not in ("", *bases):
                raise Refusal(
                    "tool_target",
                    "header.frame_id",
                    "be the arm's base",
                    message.header.frame_id,
                    ", ".join(bases),
                )
            pose = Pose.from_quaternion((p.x, p.y, p.z), (o.x, o.y, o.z, o.w))
            self._instructor.add(time_ns, pose)
        except Refusal as reason:
            self._diagnostics.refuse("tool_target", reason)
            return
        accepted = self._diagnostics.values["tool targets"]
        assert isinstance(accepted, int)
        self._diagnostics.values["tool targets"] = accepted + 1
        self._diagnostics.publish()

    def _on_joint_states(self, message: JointState) -> None:
        controller = self._controller
        if controller is None:
            return
        try:
            now = time_of("joint_states", message.header.stamp)
            if now % self._period_ns != 0:
                return
            q = self._order.arrange(message.name, message.position, POSITION)
        except Refusal as reason:
            self._diagnostics.refuse("joint_states", reason)
            return
        if self._answer is not None and now <= nanoseconds_of(self._answer.header.stamp):
            if message.header.stamp == self._answer.header.stamp:
                self._targets.publish(self._answer)  # somebody came late or lost it
                return
            self._start_over()
        instruction = self._instructor.instruct(controller, now, q)
        self._tell(controller)
        # What is published is within the bounds: the instructor sees to that.
        answer = JointState(name=controller.kinematics.joint_names)
        answer.header.stamp = message.header.stamp
        answer.position = array("d", instruction.q.tobytes())
        if instruction.v is not None:
            answer.velocity = array("d", instruction.v.tobytes())
        if instruction.tau is not None:
            answer.effort = array("d", instruction.tau.tobytes())
        self._answer = answer
        self._targets.publish(answer)

    def _tell(self, controller: Controller) -> None:
        restarts = self._instructor.restarts
        if restarts != self._diagnostics.values.get("began anew", 0):
            self._diagnostics.values["began anew"] = restarts
            self._diagnostics.error(f"{self._instructor.trouble}; began anew, the arm is held")
            return
        if self._instructor.holding:
            self._diagnostics.ok("holding, no tool target yet")
            return
        if controller.notices:
            self._diagnostics.warn("; ".join(controller.notices))
        else:
            self._diagnostics.ok("moving the tool to its target")
        self._diagnostics.values["tool error [m]"] = f"{np.linalg.norm(controller.error[:3]):.2e}"

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._start_over()
        response.success = True
        response.message = "all tool targets are forgotten, the arm is held where it is"
        return response

    def _root(self) -> tuple[str, ...]:
        return (self._controller.kinematics.base,) if self._controller is not None else ()


def main() -> None:
    """Entry point of `ros2 run arm_emulator motion_controller_node`."""
    run_node(MotionControllerNode)


if __name__ == "__main__":
    main()
