"""A servo of one's own in place of ours: 1 V for each radian that a motor is off its target.

The three-axis arm needs no more: no gravity pulls at it, and the motors' back EMF damps.
"""

import math

import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

from arm_emulator_msgs.msg import MotorCommand, MotorState

COUNT = 0.01 * 2.0 * math.pi / 1024  # rad of a joint per encoder count: gear 1/100, 1024 counts
GAIN = 100.0  # V/rad, at the joint
MOTION_TICKS = 50  # joint targets come once in so many servo periods


class MyServo(Node):
    """Answers every motor state with voltages."""

    def __init__(self) -> None:
        super().__init__("my_servo")
        self.state, self.q, self.targets = MotorState(), [], {}
        self.commands = self.create_publisher(MotorCommand, "motor_commands", 1)
        self.joint_states = self.create_publisher(JointState, "joint_states", 5)
        self.create_subscription(MotorState, "motor_states", self.on_state, qos_profile_sensor_data)
        self.create_subscription(JointState, "joint_targets", self.on_targets, 1)

    def on_state(self, state: MotorState) -> None:
        """Answer at once, or at the start of a motion period with the targets for it."""
        self.state = state
        self.q = [COUNT * (count + 0.5) for count in state.encoder_counts]
        if state.tick % MOTION_TICKS == 0:
            measured = JointState(header=state.header, name=state.joint_names, position=self.q)
            self.joint_states.publish(measured)
        else:
            self.answer()

    def on_targets(self, targets: JointState) -> None:
        """Take new targets; those that answer the newest joint states end the wait."""
        self.targets = dict(zip(targets.name, targets.position, strict=True))
        if targets.header.stamp == self.state.header.stamp:
            self.answer()

    def answer(self) -> None:
        """Publish the voltages for the servo period that began with the newest state."""
        answer = MotorCommand(header=self.state.header, tick=self.state.tick)
        answer.joint_names = self.state.joint_names
        for name, q in zip(self.state.joint_names, self.q, strict=True):
            answer.command.append(GAIN * (self.targets.get(name, q) - q))  # 0 V without a target
        self.commands.publish(answer)


rclpy.init()
try:
    rclpy.spin(MyServo())
except KeyboardInterrupt:
    pass
