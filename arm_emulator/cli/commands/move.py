"""Send a target for the tool or the joints to a running network, and report its progress."""

import math
import random
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from builtin_interfaces.msg import Duration
from cyclopts import Parameter
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.srv import GetParameters
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import command
from arm_emulator.cli.output import output
from arm_emulator.motion.executor.goal_status import describe_left
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.motion.model.pose import Pose
from arm_emulator.ros.messages.event_words import STATES
from arm_emulator.ros.messages.time_stamp import (
    NANOSECONDS,
    convert_to_nanoseconds,
    convert_to_stamp,
)
from arm_emulator.ros.node.network_client import NetworkClient, check_timeout, join_network
from arm_emulator.ros.node.node_shell import (
    COMMAND_QOS,
    DESCRIPTION_QOS,
    EVENT_QOS,
    STATE_SUB_QOS,
)
from arm_emulator.ros.recording.recorded_publisher import await_recorders
from arm_emulator_msgs.msg import MotionStatus

PATIENCE = 5.0  # s, wall, to discover a running network
AHEAD = NANOSECONDS // 4  # of logical time: the target arrives before its stamp
LATEST = 1e9  # s
IN_PROGRESS = ("accepted", "moving")


@command(keys="`states`, `outcome`, `reason`, `distance`, `angle`")
def move_tool(
    *,
    to: Annotated[tuple[float, float, float] | None, Parameter(metavar="X Y Z")] = None,
    by: Annotated[tuple[float, float, float] | None, Parameter(metavar="X Y Z")] = None,
    quaternion: Annotated[
        tuple[float, float, float, float] | None, Parameter(metavar="X Y Z W")
    ] = None,
    joints: Annotated[list[str] | None, Parameter(metavar="NAME=ANGLE ...")] = None,
    seconds: Annotated[float, Parameter(metavar="S")] = 2.0,
    at: Annotated[float | None, Parameter(metavar="S")] = None,
    timeout: Annotated[float, Parameter(metavar="S")] = 60.0,
    namespace: str = "",
) -> int:
    """Send a target over ROS, and print its states: accepted, moving, reached.

    A target is reached when the tool is within `reached_within` of motion control, by default 1 mm.
    The exit code is 0 then, and 1 when the target is refused, unreachable, replaced or aborted, or
    after the timeout.

    Args:
        to: target of the tool (m, in the world).
        by: displacement of the tool from its present position (m, in the world).
        quaternion: orientation of the tool (default: unchanged).
        joints: angles of joints (rad or m); the others hold.
        seconds: logical time of a motion of joints.
        at: logical time at which the target takes effect, so that runs can be repeated (default:
            soon).
        timeout: wall time to wait for the end.
        namespace: of the network, such as /cell1.
    """
    options = [name for name, value in (("--to", to), ("--by", by), ("--joints", joints)) if value]
    if len(options) != 1:
        valid = "--to X Y Z, --by X Y Z, or --joints NAME=ANGLE ..."
        actual = " and ".join(options) or "none"
        raise Refusal("move", "the target", "be one", actual, valid)
    if not (math.isfinite(seconds) and seconds > 0.0):
        raise Refusal("move", "--seconds", "be > 0 and finite", seconds)
    if at is not None and not 0.0 < at < LATEST:
        raise Refusal("move", "--at", f"be > 0 s and below {LATEST:g} s", at)
    check_timeout("move", timeout)
    angles = _parse_angles(joints or ())
    with join_network("move", namespace) as node:
        node.listen_to("joint_states", JointState, STATE_SUB_QOS)
        node.listen_to("robot_description", String, DESCRIPTION_QOS)
        node.listen_to("clock", Clock, STATE_SUB_QOS)
        # A machine that stands repeats its time, but its servo repeats nothing.
        needed = "clock" if to and quaternion else "joint_states"
        if not node.spin_until(lambda: needed in node.newest, PATIENCE):
            if "clock" in node.newest:
                rule, valid = "be known", "--to with --quaternion; or let the machine go on"
                raise Refusal("move", "position of an arm that stands", rule, "none", valid)
            raise _refuse_no_network(f"{needed} be published")
        if joints:
            kind, topic = MotionStatus.KIND_JOINT_TRAJECTORY, "joint_trajectory"
            publisher = node.create_publisher(JointTrajectory, topic, COMMAND_QOS)
            message = _make_trajectory(node.newest["joint_states"], angles, seconds)
        else:
            kind, topic = MotionStatus.KIND_TOOL_TARGET, "tool_target"
            publisher = node.create_publisher(PoseStamped, topic, COMMAND_QOS)
            message = _make_tool_target(node, to, by, quaternion)
        at_ns = None if at is None else round(at * NANOSECONDS)
        return _watch_goal(node, publisher, message, kind, at_ns, timeout)


def _watch_goal(
    node: NetworkClient,
    publisher: Publisher,
    message: PoseStamped | JointTrajectory,
    kind: int,
    at_ns: int | None,
    timeout: float,
) -> int:
    heard: list[MotionStatus] = []
    node.create_subscription(MotionStatus, "motion/status", heard.append, EVENT_QOS)
    if not node.spin_until(lambda: node.is_heard(publisher, "motion/status"), PATIENCE):
        raise _refuse_no_network(f"a motion controller take {publisher.topic_name}")
    await_recorders(node, publisher)
    now = _find_logical_time(node)
    if at_ns is not None and at_ns <= now:
        rule, actual = f"be later than logical time, {now / NANOSECONDS:g} s", at_ns / NANOSECONDS
        raise Refusal(
            "move", "--at", rule, f"{actual:g} s", "a network started with --start paused"
        )
    # The stamp distinguishes it from the targets of others.
    ours = at_ns or now + AHEAD + random.randrange(1, 1000)
    message.header.stamp = convert_to_stamp(ours)
    publisher.publish(message)
    states: list[str] = []
    last: MotionStatus | None = None

    def has_ended() -> bool:
        nonlocal last
        while heard:
            status = heard.pop(0)
            state = STATES.get(status.state, f"state {status.state}")
            if (
                status.kind != kind
                or convert_to_nanoseconds(status.stamp) != ours
                or state in states
            ):
                continue
            states.append(state)
            last = status
            output.print_line(
                f"{state}{_format_distance(status)}{f': {status.reason}' if status.reason else ''}"
            )
        return bool(states) and states[-1] not in IN_PROGRESS

    if not node.spin_until(has_ended, timeout):
        output.print_line(f"no end within {timeout:g} s of wall time: {states[-1:] or 'no answer'}")
    outcome = states[-1] if states else "no answer"
    output.add_facts(
        {
            "states": states,
            "outcome": outcome,
            "reason": last.reason if last else "",
            "distance": last.distance if last else math.nan,
            "angle": last.angle if last else math.nan,
        }
    )
    return 0 if outcome == "reached" else 1


def _find_logical_time(node: NetworkClient) -> int:
    """Return logical time by the newest messages [ns]."""
    newest = node.newest
    stamps = [newest["joint_states"].header.stamp] if "joint_states" in newest else []
    stamps += [newest["clock"].clock] if "clock" in newest else []
    return max(map(convert_to_nanoseconds, stamps))


def _format_distance(status: MotionStatus) -> str:
    if status.state not in (MotionStatus.STATE_REACHED, MotionStatus.STATE_UNREACHABLE):
        return ""
    return describe_left(status.distance, status.angle)


def _parse_angles(options: Sequence[str]) -> dict[str, float]:
    angles = dict[str, float]()
    for option in options:
        name, sign, text = option.partition("=")
        try:
            angles[name] = float(text)
        except ValueError:
            sign = ""
        if not (sign and name and math.isfinite(angles[name])):
            raise Refusal("move", "--joints", "be NAME=ANGLE, in rad or m", option)
    return angles


def _make_trajectory(now: JointState, angles: dict[str, float], seconds: float) -> JointTrajectory:
    """Return a trajectory of one point: the given joints, and the others at their positions."""
    positions = dict(zip(now.name, now.position, strict=True))
    for name in angles:
        if name not in positions:
            raise Refusal("move", "--joints", "name joints", name, ", ".join(positions))
    goal = {**positions, **angles}
    full_seconds, rest = divmod(round(seconds * NANOSECONDS), NANOSECONDS)
    point = JointTrajectoryPoint(
        positions=list(goal.values()), time_from_start=Duration(sec=full_seconds, nanosec=rest)
    )
    return JointTrajectory(joint_names=list(goal), points=[point])


def _make_tool_target(
    node: NetworkClient,
    to: Sequence[float] | None,
    by: Sequence[float] | None,
    quaternion: Sequence[float] | None,
) -> PoseStamped:
    """Return the pose; missing values are those of the measured tool."""
    message = PoseStamped()
    if to is None or quaternion is None:
        R_WT, p_WT = _compute_tool_pose(node)
        turn = Pose(p_WT, R_WT).quaternion() if quaternion is None else quaternion
        where = p_WT + np.array(by) if by is not None else to
    else:
        turn, where = quaternion, to
    assert where is not None
    p, o = message.pose.position, message.pose.orientation
    p.x, p.y, p.z = map(float, where)
    o.x, o.y, o.z, o.w = map(float, turn)
    return message


def _compute_tool_pose(node: NetworkClient) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation and position of the motion controller's tool, from the measured angles."""
    client = node.create_client(GetParameters, "motion_controller/get_parameters")

    def is_ready() -> bool:
        return "robot_description" in node.newest and client.service_is_ready()

    if not node.spin_until(is_ready, PATIENCE):
        raise _refuse_no_network("robot_description and a motion controller be present")
    answer = node.call_service(client, GetParameters.Request(names=["tool"]), PATIENCE)
    if answer is None:
        raise _refuse_no_network("the motion controller answer")
    now = node.newest["joint_states"]
    tool = answer.values[0].string_value
    kinematics = Kinematics(node.newest["robot_description"].data, list(now.name), tool)
    return kinematics.forward(np.array(now.position))


def _refuse_no_network(rule: str) -> Refusal:
    quantity, _, rest = rule.partition(" ")
    valid = "start it (`arm_emulator up`) in the same ROS_DOMAIN_ID and namespace"
    return Refusal("move", f"in the network, {quantity}", rest, f"nothing in {PATIENCE:g} s", valid)
