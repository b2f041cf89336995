"""Orders one after the other over a network in lock-step: each is answered, no node is lost."""

from __future__ import annotations

from pathlib import Path as File

import numpy as np
import pytest
from draws import FULL
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from network import SEND_QOS, User, network

from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.ros.node_shell import EVENT_QOS
from arm_emulator.runs.offline import load_offline_run
from arm_emulator_msgs.msg import MotionStatus

SEQUENCES = 25 if FULL else 2
POSES = 4
SIDE = 0.04  # m, of the box in which the poses of a path are drawn


def path(points: np.ndarray) -> Path:
    """Return a path through points; three joints leave the orientation free."""
    message = Path()
    for x, y, z in points.tolist():
        one = PoseStamped()
        one.pose.position.x, one.pose.position.y, one.pose.position.z = x, y, z
        one.pose.orientation.w = 1.0
        message.poses.append(one)
    return message


def statuses(user: User) -> list[MotionStatus]:
    """Return what the motion controller reports, from now on."""
    heard: list[MotionStatus] = []
    user.node.create_subscription(MotionStatus, "motion/status", heard.append, EVENT_QOS)
    return heard


def test_paths_one_after_the_other_are_all_reached(tmp_path: File) -> None:
    """Drawn paths, each sent when the one before is reached; the nodes end cleanly afterwards."""
    rng = np.random.default_rng(0)
    scene = load_offline_run("three_axis").session.scene
    home = Kinematics(scene.urdf, scene.joint_names, scene.tool).forward(scene.start)[1]
    with network(tmp_path, start="first_answer") as (user, _):
        user.wait("the run", lambda: user.tick > 200)
        heard = statuses(user)
        paths = user.node.create_publisher(Path, "tool_path", SEND_QOS)
        for number in range(1, SEQUENCES + 1):
            user.publish(paths, path(home + rng.uniform(-0.5, 0.5, (POSES, 3)) * SIDE))
            user.wait(
                f"the end of path {number}",
                lambda number=number: [
                    one for one in heard if one.number == number and one.state > 2
                ],
            )
            last = next(one for one in heard if one.number == number and one.state > 2)
            assert last.state == MotionStatus.STATE_REACHED, last.reason


def test_joint_jogs_over_a_network(tmp_path: File) -> None:
    """A JointJog moves its joint and no other; without control_msgs there is no such topic."""
    messages = pytest.importorskip("control_msgs.msg", reason="control_msgs is not installed")
    with network(tmp_path, start="first_answer") as (user, _):
        jogs = user.node.create_publisher(
            messages.JointJog, "motion_controller/delta_joint_cmds", SEND_QOS
        )
        name = user.joint_names[0]
        user.wait("the run", lambda: user.tick > 200)  # before, jogs are refused
        before = user.wait("joint states", lambda: user.truth).position[0]
        user.publish(jogs, messages.JointJog(joint_names=[name], velocities=[0.5]))
        user.wait("its motion", lambda: abs(user.truth.position[0] - before) > 1e-3)
