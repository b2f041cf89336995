"""The node of the motion controller: its topics follow, refuse and report as the library does."""

import importlib.util
from collections.abc import Iterator

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import PoseStamped
from ideal_arm import SECOND
from in_process import InProcess, in_process
from nav_msgs.msg import Path
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from arm_emulator.motion.executor.goal_status import Kind
from arm_emulator.motion.model.pose import Pose
from arm_emulator.motion.trajectory.joint_trajectory import TrajectoryPoint
from arm_emulator.ros.messages.time_stamp import convert_to_stamp
from arm_emulator.runs.offline import OfflineRun, load_offline_run
from arm_emulator_msgs.msg import MotionStatus
from motion_controller_node.follow_action import is_installed


@pytest.fixture(scope="module")
def nodes() -> Iterator[InProcess]:
    with in_process() as inside:
        inside.run_to(5)  # the description has come
        yield inside


def statuses(nodes: InProcess) -> list[MotionStatus]:
    """Collect the messages on the motion controller's status topic, from now on."""
    heard: list[MotionStatus] = []
    nodes.listen_alone("motion/status", MotionStatus, heard.append)
    return heard


def trajectory(at_ns: int, names: list[str], *points: tuple[float, list[float]]) -> JointTrajectory:
    message = JointTrajectory(joint_names=names)
    message.header.stamp = convert_to_stamp(at_ns)
    message.points = [
        JointTrajectoryPoint(
            positions=q, time_from_start=Duration(sec=int(t), nanosec=round(t % 1 * 1e9))
        )
        for t, q in points
    ]
    return message


def path(at_ns: int, poses: list[Pose]) -> Path:
    message = Path()
    message.header.stamp = convert_to_stamp(at_ns)
    for pose in poses:
        stamped = PoseStamped()
        p, o = stamped.pose.position, stamped.pose.orientation
        p.x, p.y, p.z = map(float, pose.p_WT)
        o.x, o.y, o.z, o.w = map(float, pose.quaternion())
        message.poses.append(stamped)
    return message


def offline() -> OfflineRun:
    return load_offline_run("three_axis")


def test_nodes_and_offline_run_follow_a_trajectory_and_a_path_with_the_same_bits(
    nodes: InProcess,
) -> None:
    run = offline()
    names = list(run.controller.kinematics.joint_names)
    start = run.session.scene.start
    R, p = run.controller.kinematics.forward(start)
    goal = (start + 0.05).tolist()
    # By way of the quaternion, as in the message: the rotation has the same rounding then.
    poses = [
        Pose.from_quaternion(p + shift, Pose(p, R).quaternion())
        for shift in (np.array([0.0, 0.02, 0.0]), np.array([0.02, 0.02, 0.0]))
    ]
    heard = statuses(nodes)
    nodes.run_to(20)
    nodes.send("joint_trajectory", trajectory(SECOND // 10, names, (0.3, goal)))
    nodes.send("tool_path", path(SECOND, poses))
    nodes.run_to(1400)
    run.instructor.add_trajectory(
        run.controller, names, [TrajectoryPoint(3 * SECOND // 10, goal)], SECOND // 10
    )
    run.instructor.add_path(run.controller, poses, SECOND)
    for tick in range(1400):
        state = run.session.measured
        bits = np.asarray(state.encoder_counts, dtype=np.int64).tobytes() + state.current.tobytes()
        assert nodes.states[tick] == bits, f"the first other bit at tick {tick}"
        run.advance(1)
    for status, report in zip(heard, run.instructor.reports.waiting, strict=False):
        assert (status.kind, status.number, status.state) == (
            report.kind,
            report.number,
            report.state,
        )
    printed = [(status.kind, status.state) for status in heard]
    assert (2, MotionStatus.STATE_REACHED) in printed and (3, MotionStatus.STATE_MOVING) in printed
    assert nodes.newest("joint_targets").velocity, "speeds reach the servo"


BAD = {
    "joint_trajectory": "joint must be one of the arm, got nobody",
    "tool_path": "poses must be from 1",
    "tool_target": "header.frame_id must be the arm's base, got elsewhere",
}


@pytest.mark.parametrize("topic", BAD)
def test_refused_orders_are_reported_with_their_reason(nodes: InProcess, topic: str) -> None:
    """Further refusals: test_joint_trajectory.py, test_tool_path.py, test_pose.py."""
    names = list(nodes.nodes["motion_controller"]._controller.kinematics.joint_names)
    target = PoseStamped()
    target.header.frame_id = "elsewhere"
    messages = {
        "joint_trajectory": trajectory(0, [*names[1:], "nobody"], (1.0, [0.0] * len(names))),
        "tool_path": Path(),
        "tool_target": target,
    }
    heard, before = statuses(nodes), nodes.refused("motion_controller")
    nodes.send(topic, messages[topic])
    nodes.deliver()
    while nodes._wires.waiting and not heard:
        nodes.deliver()
    [status] = heard
    assert status.state == MotionStatus.STATE_REFUSED and BAD[topic] in status.reason
    assert status.kind == Kind[topic.upper()] and status.number > 0
    assert nodes.refused("motion_controller") == before + 1


def test_a_reset_reports_the_commands_that_it_forgets(nodes: InProcess) -> None:
    heard = statuses(nodes)
    pose = path(0, [Pose(np.array([0.3, 0.0, 0.5]), np.eye(3))]).poses[0]
    pose.header.stamp = convert_to_stamp(1000 * SECOND)
    nodes.send("tool_target", pose)
    nodes.call("motion_controller/reset")
    expected = [MotionStatus.STATE_ACCEPTED, MotionStatus.STATE_ABORTED]
    while [status.state for status in heard if status.kind == Kind.TOOL_TARGET] != expected:
        assert nodes.deliver(), f"nothing more is reported after {heard}"
    assert heard[-1].reason == "the motion controller was reset"


def test_the_action_is_there_only_where_control_msgs_is(nodes: InProcess) -> None:
    has_it = importlib.util.find_spec("control_msgs") is not None
    assert is_installed() == has_it
    assert (nodes.nodes["motion_controller"]._action is not None) == has_it
