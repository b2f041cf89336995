"""The examples of README.md do what it says."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from network import PATIENCE, network

from arm_emulator.node_shell import NANOSECONDS, nanoseconds_of
from emulator_node.scene import load_scene
from motion_controller_node.jacobian import JacobianController
from motion_controller_node.motion_config import load_motion_config
from motion_controller_node.predicted_residual import predicted_residual
from servo_node.servo_config import load_servo_config

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "docs" / "examples"


@contextmanager
def example(name: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run an example in the ROS domain of the test; it must end cleanly on Ctrl-C."""
    process = subprocess.Popen([sys.executable, str(EXAMPLES / f"{name}.py"), *arguments])
    try:
        yield process
        assert process.poll() is None, f"{name} ended by itself with {process.returncode}"
    finally:
        process.send_signal(signal.SIGINT)
        code = process.wait(PATIENCE)
    assert code == 0


def test_a_servo_of_ones_own_brings_the_tool_to_its_target(tmp_path: Path) -> None:
    scene = load_scene("three_axis")
    motion = load_motion_config(ROOT / "config" / "motion" / "three_axis.yaml")
    servo = load_servo_config(ROOT / "config" / "servo" / "three_axis.yaml")
    controller = JacobianController(scene.urdf, scene.joint_names, **motion.controller_arguments())
    count = np.array([joint.count_angle for joint in servo.joints])
    target = np.array([0.43, 0.05, 0.64])
    inside: list[int] = []  # when the tool is where it shall be [ns]

    with (
        network(tmp_path, only=("emulator", "motion_controller"), start="first_answer") as (
            user,
            _,
        ),
        example("my_servo"),
    ):

        def settled() -> bool:
            """Whether the tool has been at its target for 0.5 s of logical time."""
            if user.truth is None:
                return False
            q = np.array(user.truth.position)
            # This servo has no integral action, and holds within a whole count.
            bound = predicted_residual(controller, q, count, held_within=1.0).encoder
            if (np.abs(target - controller.forward(q)[1]) > bound).any():
                inside.clear()
                return False
            inside.append(nanoseconds_of(user.truth.header.stamp))
            return inside[-1] - inside[0] > NANOSECONDS // 2

        words = [repr(float(x)) for x in target]
        with subprocess.Popen([sys.executable, str(EXAMPLES / "move_tool.py"), *words]) as sender:
            user.wait("the tool at its target", settled)
        assert sender.returncode == 0


def test_a_motion_controller_of_ones_own_swings_the_waist(tmp_path: Path) -> None:
    q: list[np.ndarray] = []
    with (
        network(tmp_path, only=("emulator", "servo"), start="first_answer") as (user, _),
        example("my_motion_controller"),
    ):

        def swung() -> bool:
            if user.truth:
                q.append(np.array(user.truth.position))
            return user.status is not None and user.status.logical_time > 3.5

        user.wait("three and a half seconds", swung)
    waist, *others = np.array(q).T
    start = load_scene("three_axis").start
    # 0.4 rad to one side and back. Steps of 50 ms, the last to 0.399 rad of the peak and held there
    # 50 ms; a servo of position gain 25 / s is within 0.004 rad of them when they are small.
    assert abs(waist.max() - 0.4) < 0.01
    assert abs(waist[len(waist) // 3 :].min()) < 0.01
    # The others stand, but for the waist's centrifugal pull in their gears.
    assert np.abs(np.array(others).T - start[1:]).max() < 1e-3
