"""Topics of the three nodes: what bags hold of them, and replays give to them."""

from dataclasses import dataclass, field

from arm_emulator_msgs.msg import MotionStatus

# Type of each topic, by its name in the network's namespace.
TYPES = {
    "motor_states": "arm_emulator_msgs/msg/MotorState",
    "motor_commands": "arm_emulator_msgs/msg/MotorCommand",
    "joint_states": "sensor_msgs/msg/JointState",
    "joint_targets": "sensor_msgs/msg/JointState",
    "servo_states": "arm_emulator_msgs/msg/ServoState",
    "robot_description": "std_msgs/msg/String",
    "tool_target": "geometry_msgs/msg/PoseStamped",
    "joint_trajectory": "trajectory_msgs/msg/JointTrajectory",
    "tool_path": "nav_msgs/msg/Path",
    "motion_controller/delta_twist_cmds": "geometry_msgs/msg/TwistStamped",
    "motion_controller/delta_joint_cmds": "control_msgs/msg/JointJog",
    "motion/status": "arm_emulator_msgs/msg/MotionStatus",
    "emulator/joint_states": "sensor_msgs/msg/JointState",
    "emulator/events": "arm_emulator_msgs/msg/MachineEvent",
    "emulator/status": "arm_emulator_msgs/msg/EmulatorStatus",
    "diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
BY_EMULATOR = ("motor_states", "motor_commands", "robot_description", "diagnostics")
OF_OTHERS = tuple(
    name for name in TYPES if name not in BY_EMULATOR and not name.startswith("emulator/")
)
STATUS = "motion/status"


@dataclass(frozen=True)
class NodeTopics:
    """Topics of a node in lock-step.

    Attributes:
        requests: topic of the messages that it answers.
        answered: topic of its answers.
        prompt: topic on which it publishes before it waits for `granted`, with the stamp of what it
            was asked; empty: it never waits.
        granted: topic of the messages for which it waits, with the same stamp.
        beside: topic of messages that it needs with those of `requests` with the same stamp.
        at_first: topic of a message that it needs before all others.
        orders: topics of orders, by their kinds in `motion/status`.
        jogs: topics of orders without a status of their own.
    """

    requests: str
    answered: str
    prompt: str = ""
    granted: str = ""
    beside: str = ""
    at_first: str = ""
    orders: dict[int, str] = field(default_factory=dict)
    jogs: tuple[str, ...] = ()

    @property
    def inputs(self) -> tuple[str, ...]:
        """Topics that are published to it."""
        names = (self.requests, self.granted, self.beside, self.at_first, *self.orders.values())
        return tuple(name for name in (*names, *self.jogs) if name)


NODES = {
    "servo": NodeTopics("motor_states", "motor_commands", "joint_states", "joint_targets"),
    "motion_controller": NodeTopics(
        "joint_states",
        "joint_targets",
        beside="servo_states",
        at_first="robot_description",
        orders={
            MotionStatus.KIND_TOOL_TARGET: "tool_target",
            MotionStatus.KIND_JOINT_TRAJECTORY: "joint_trajectory",
            MotionStatus.KIND_TOOL_PATH: "tool_path",
        },
        jogs=("motion_controller/delta_twist_cmds", "motion_controller/delta_joint_cmds"),
    ),
}
