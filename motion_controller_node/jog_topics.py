"""Jogging by topics, with the names and types of MoveIt Servo.

`~/delta_twist_cmds` moves the tool, `~/delta_joint_cmds` joints (where control_msgs is installed);
`~/status` has the code of the active limit of the motion.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import TwistStamped
from rclpy.node import Node
from std_msgs.msg import Header, Int8

from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.controller import Controller
from arm_emulator.motion.instructor import Instructor
from arm_emulator.motion.jog import JogCommand, joint_command, twist_command
from arm_emulator.motion.motion_config import MotionConfig
from arm_emulator.motion.motion_report import Kind
from arm_emulator.ros.node_shell import COMMAND_SUB_QOS, EVENT_QOS, time_of

try:
    from control_msgs.msg import JointJog
except ImportError:  # no wheel has it
    JointJog = None

_SECONDS = 1e-9


class JogTopics:
    """Takes jog commands.

    Args:
        node: node of the topics.
        instructor: follows them.
        take: calls a function for a message, and publishes its result.
        now: returns controller, parameters and logical time [ns].
    """

    def __init__(
        self,
        node: Node,
        instructor: Instructor,
        take: Callable[[Kind, Header, Callable[[], None]], Any],
        now: Callable[[], tuple[Controller | None, MotionConfig, int]],
    ) -> None:
        self._instructor, self._take, self._now = instructor, take, now
        self._status = node.create_publisher(Int8, "~/status", EVENT_QOS)
        self._published: int | None = None
        node.create_subscription(
            TwistStamped, "~/delta_twist_cmds", self._on_twist, COMMAND_SUB_QOS
        )
        if JointJog is not None:
            node.create_subscription(
                JointJog, "~/delta_joint_cmds", self._on_joints, COMMAND_SUB_QOS
            )

    def publish(self) -> None:
        """Publish the code of the jog's limit, if it has changed."""
        jog = self._instructor.jogging
        code = 0 if jog is None else int(jog.status)
        if code != self._published:
            self._published = code
            self._status.publish(Int8(data=code))

    def _on_twist(self, message: TwistStamped) -> None:
        def command() -> JogCommand:
            controller, config, now = self._known("delta_twist_cmds")
            kinematics = controller.kinematics
            linear, angular = message.twist.linear, message.twist.angular
            twist = (linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
            time_ns = _time(message.header, now, config, "delta_twist_cmds")
            return twist_command(time_ns, twist, message.header.frame_id, kinematics, config)

        self._jog(message.header, command)

    def _on_joints(self, message: Any) -> None:
        def command() -> JogCommand:
            controller, config, now = self._known("delta_joint_cmds")
            if len(message.displacements):
                rule = "be empty: speeds are taken, no displacements"
                raise Refusal(
                    "delta_joint_cmds", "displacements", rule, list(message.displacements)
                )
            time_ns = _time(message.header, now, config, "delta_joint_cmds")
            names, speeds = list(message.joint_names), message.velocities
            return joint_command(time_ns, names, speeds, controller.kinematics, config)

        self._jog(message.header, command)

    def _jog(self, header: Header, command: Callable[[], JogCommand]) -> None:
        self._take(Kind.JOG, header, lambda: self._instructor.jog(command()))

    def _known(self, topic: str) -> tuple[Controller, MotionConfig, int]:
        controller, config, now = self._now()
        if controller is None:
            raise Refusal(topic, "the message", "come after the robot description", "none so far")
        return controller, config, now


def _time(header: Header, now: int, config: MotionConfig, topic: str) -> int:
    """Return the logical time of a command [ns]: its stamp; 0: now."""
    stamped = time_of(topic, header.stamp)
    timeout = config.jog_incoming_command_timeout
    late = (now - stamped) * _SECONDS
    if stamped and abs(late) > timeout:
        rule = f"be 0 for now, or within {timeout:g} s of logical time {now * _SECONDS:g} s"
        raise Refusal(topic, "header.stamp", rule, f"{stamped * _SECONDS:.10g} s")
    return stamped or now
