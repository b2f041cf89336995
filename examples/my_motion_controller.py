"""A motion controller of one's own in place of ours: swings the first joint to and fro."""

import math

import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from sensor_msgs.msg import JointState

PERIOD = 50_000_000  # ns; `motion_period` of our servo


class MyMotionController(Node):
    """Answers the joint states of every motion period with joint targets of the same stamp."""

    def __init__(self) -> None:
        super().__init__("my_motion_controller")
        self.start: list[float] = []
        self.joint_targets = self.create_publisher(JointState, "joint_targets", 1)
        self.create_subscription(
            JointState, "joint_states", self.on_joint_states, qos_profile_sensor_data
        )

    def on_joint_states(self, states: JointState) -> None:
        """Send the targets for this instant."""
        now = Time.from_msg(states.header.stamp).nanoseconds
        if now % PERIOD != 0:
            return
        self.start = self.start or list(states.position)
        swing = 0.2 * (1.0 - math.cos(math.pi * now * 1e-9))  # rad, once in 2 s
        q = [self.start[0] + swing, *self.start[1:]]
        self.joint_targets.publish(JointState(header=states.header, name=states.name, position=q))


rclpy.init()
try:
    rclpy.spin(MyMotionController())
except KeyboardInterrupt:
    pass
