"""Orders by topics: tool targets, joint trajectories, tool paths and jog commands.

Jogs have the names and types of MoveIt Servo: `~/delta_twist_cmds` moves the tool,
`~/delta_joint_cmds` joints (where control_msgs is installed); `~/status` has the code of the active
limit of the motion.
"""

from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import Pose as PoseOfMessage
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Path
from rclpy.node import Node
from std_msgs.msg import Header, Int8
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.executor.goal_status import Kind
from arm_emulator.motion.executor.jog import JogCommand, make_joint_command, make_twist_command
from arm_emulator.motion.executor.motion_executor import MotionExecutor
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.pose import Pose
from arm_emulator.motion.planner.tool_controller import Controller
from arm_emulator.motion.trajectory.joint_trajectory import TrajectoryPoint, check_number_of_points
from arm_emulator.motion.trajectory.tolerances import Tolerances
from arm_emulator.motion.trajectory.tool_path import check_number_of_poses
from arm_emulator.ros.messages.time_stamp import NANOSECONDS, check_time
from arm_emulator.ros.node.node_shell import COMMAND_SUB_QOS, EVENT_QOS, Diagnostics

try:
    from control_msgs.msg import JointJog
except ImportError:  # no wheel has it
    JointJog = None

_SECONDS = 1e-9
PLURALS = {
    Kind.TOOL_TARGET: "tool targets",
    Kind.JOINT_TRAJECTORY: "joint trajectories",
    Kind.TOOL_PATH: "tool paths",
    Kind.JOG: "jog commands",
}


class OrderTopics:
    """Takes targets, trajectories, paths and jog commands.

    Args:
        node: node of the topics.
        motion: follows the orders.
        diagnostics: count them.
        report: publishes what became of them.
        now: returns controller (None: no robot description so far), parameters and logical time
            [ns].
    """

    def __init__(
        self,
        node: Node,
        motion: MotionExecutor,
        diagnostics: Diagnostics,
        report: Callable[[], None],
        now: Callable[[], tuple[Controller | None, MotionConfig, int]],
    ) -> None:
        self._motion, self._diagnostics = motion, diagnostics
        self._report, self._now = report, now
        self._status = node.create_publisher(Int8, "~/status", EVENT_QOS)
        self._published: int | None = None
        for kind, topic, callback in (
            (PoseStamped, "tool_target", self._handle_tool_target),
            (JointTrajectory, "joint_trajectory", self._handle_joint_trajectory),
            (Path, "tool_path", self._handle_tool_path),
            (TwistStamped, "~/delta_twist_cmds", self._handle_twist),
            (JointJog, "~/delta_joint_cmds", self._handle_joint_jog),
        ):
            if kind is not None:
                node.create_subscription(kind, topic, callback, COMMAND_SUB_QOS)

    def add_trajectory(
        self,
        message: JointTrajectory,
        tolerances: Callable[[Tolerances], Tolerances] = lambda default: default,
    ) -> None:
        """Hand a trajectory over.

        Args:
            message: the trajectory.
            tolerances: returns its tolerances, given the default ones.
        """
        check_number_of_points(len(message.points))
        stamp_ns = check_time("joint_trajectory", message.header.stamp)
        points = [_read_trajectory_point(i, point) for i, point in enumerate(message.points)]
        names, controller = list(message.joint_names), self._now()[0]
        self._motion.add_trajectory(controller, names, points, stamp_ns, tolerances)

    def take_order(self, kind: Kind, header: Header, take: Callable[[], None]) -> Refusal | None:
        """Hand over an order, and publish its result; return the reason of a refusal."""
        refusal = None
        reports = self._motion.reports
        before = reports.numbers[kind]
        try:
            take()
        except Refusal as reason:
            if reports.numbers[kind] == before:  # the executor has not received it
                reports.refuse_goal(kind, _read_stamp(header), reason)
            self._diagnostics.refuse_input(kind.topic, reason)
            refusal = reason
        else:
            accepted = self._diagnostics.values[PLURALS[kind]]
            assert isinstance(accepted, int)
            self._diagnostics.values[PLURALS[kind]] = accepted + 1
            self._diagnostics.publish_now()
        self._report()
        return refusal

    def publish_limit(self) -> None:
        """Publish the code of the jog's limit, if it has changed."""
        jog = self._motion.jogging
        code = 0 if jog is None else int(jog.status)
        if code != self._published:
            self._published = code
            self._status.publish(Int8(data=code))

    def _handle_tool_target(self, message: PoseStamped) -> None:
        def take_target() -> None:
            self._check_frame("tool_target", message.header)
            time_ns = check_time("tool_target", message.header.stamp)
            self._motion.add(time_ns, _read_pose(message.pose, "tool_target"))

        self.take_order(Kind.TOOL_TARGET, message.header, take_target)

    def _handle_joint_trajectory(self, message: JointTrajectory) -> None:
        self.take_order(Kind.JOINT_TRAJECTORY, message.header, lambda: self.add_trajectory(message))

    def _handle_tool_path(self, message: Path) -> None:
        def take_path() -> None:
            check_number_of_poses(len(message.poses))
            for header in (message.header, *(pose.header for pose in message.poses)):
                self._check_frame("tool_path", header)
            stamp_ns = check_time("tool_path", message.header.stamp)
            times = [check_time("tool_path", pose.header.stamp) for pose in message.poses]
            # Planners put one stamp on all poses, or none: such stamps carry no times.
            distinct_times = times if len(set(times)) > 1 else None
            poses = [_read_pose(pose.pose, "tool_path") for pose in message.poses]
            self._motion.add_path(self._now()[0], poses, stamp_ns, distinct_times)

        self.take_order(Kind.TOOL_PATH, message.header, take_path)

    def _handle_twist(self, message: TwistStamped) -> None:
        def make_command() -> JogCommand:
            controller, config, time_ns = self._read_jog("delta_twist_cmds", message.header)
            linear, angular = message.twist.linear, message.twist.angular
            twist = (linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
            link = message.header.frame_id
            return make_twist_command(time_ns, twist, link, controller.kinematics, config)

        self.take_order(Kind.JOG, message.header, lambda: self._motion.take_jog(make_command()))

    def _handle_joint_jog(self, message: Any) -> None:
        def make_command() -> JogCommand:
            topic = "delta_joint_cmds"
            if len(message.displacements):
                rule = "be empty: speeds are taken, no displacements"
                raise Refusal(topic, "displacements", rule, list(message.displacements))
            controller, config, time_ns = self._read_jog(topic, message.header)
            names, speeds = list(message.joint_names), message.velocities
            return make_joint_command(time_ns, names, speeds, controller.kinematics, config)

        self.take_order(Kind.JOG, message.header, lambda: self._motion.take_jog(make_command()))

    def _read_jog(self, topic: str, header: Header) -> tuple[Controller, MotionConfig, int]:
        """Return controller, parameters and the logical time of a command [ns]."""
        controller, config, now = self._now()
        if controller is None:
            raise Refusal(topic, "the message", "come after the robot description", "none so far")
        stamped, timeout = check_time(topic, header.stamp), config.jog_incoming_command_timeout
        if stamped and abs((now - stamped) * _SECONDS) > timeout:
            rule = f"be 0 for now, or within {timeout:g} s of logical time {now * _SECONDS:g} s"
            raise Refusal(topic, "header.stamp", rule, f"{stamped * _SECONDS:.10g} s")
        return controller, config, stamped or now

    def _check_frame(self, topic: str, header: Header) -> None:
        controller = self._now()[0]
        root = () if controller is None else (controller.kinematics.base,)
        bases = list(dict.fromkeys(("world", *root)))
        if header.frame_id not in ("", *bases):
            rule, valid = "be the arm's base", ", ".join(bases)
            raise Refusal(topic, "header.frame_id", rule, header.frame_id, valid)


def _read_trajectory_point(i: int, point: JointTrajectoryPoint) -> TrajectoryPoint:
    """Return a point of a trajectory from its message."""
    time = point.time_from_start
    if time.nanosec >= NANOSECONDS:
        where, actual = f"points[{i}].time_from_start", f"{time.nanosec} ns"
        raise Refusal("joint_trajectory", where, "have less than 1e9 ns", actual)
    return TrajectoryPoint(
        int(time.sec) * NANOSECONDS + int(time.nanosec),
        point.positions,
        point.velocities,
        point.accelerations,
        point.effort,
    )


def _read_pose(pose: PoseOfMessage, where: str) -> Pose:
    p, o = pose.position, pose.orientation
    return Pose.from_quaternion((p.x, p.y, p.z), (o.x, o.y, o.z, o.w), where)


def _read_stamp(header: Header) -> int:
    """Return the logical time of a header [ns], 0 for an invalid one."""
    try:
        return check_time("header", header.stamp)
    except Refusal:
        return 0
