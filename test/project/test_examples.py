"""The examples of README.md do what it states."""

import json
import runpy
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from network import PATIENCE, network
from test_command_line import run as command

from arm_emulator import load_scene, load_servo_config
from arm_emulator.cli.commands import status
from arm_emulator.motion.model.config import load_motion_config
from arm_emulator.motion.planner.tool_controller import make_controller
from arm_emulator.ros.messages.time_stamp import NANOSECONDS, convert_to_nanoseconds
from oracles.predicted_residual import predict_residual

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"


@contextmanager
def example(name: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run an example in the ROS domain of the test; it must end on Ctrl-C."""
    process = subprocess.Popen([sys.executable, str(EXAMPLES / f"{name}.py"), *arguments])
    try:
        yield process
        assert process.poll() is None, f"{name} ended by itself with {process.returncode}"
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE)  # whichever the code: rclpy may fail when a signal ends it


@pytest.mark.slow
def test_a_servo_of_ones_own_that_restarts_brings_the_tool_to_its_target(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load_scene("three_axis")
    motion = load_motion_config(ROOT / "config" / "motion" / "three_axis.yaml")
    servo = load_servo_config(ROOT / "config" / "servo" / "three_axis.yaml")
    controller = make_controller(scene.urdf, scene.joint_names, motion)
    count = np.array([joint.count_angle for joint in servo.joints])
    target = np.array([0.43, 0.05, 0.64])
    inside: list[int] = []  # when the tool is where it shall be [ns]

    with network(tmp_path, only=("emulator", "motion_controller"), start="first_answer") as (
        user,
        _,
    ):
        for _ in range(2):  # one of them ends within a motion period
            before = user.tick
            with example("my_servo"):
                user.wait("a hundred ticks", lambda before=before: user.tick > before + 100)

        def settled() -> bool:
            """Whether the tool has been at its target for 0.5 s of logical time."""
            if user.truth is None:
                return False
            q = np.array(user.truth.position)
            # This servo has no integral action, and holds within a whole count.
            bound = predict_residual(controller, q, count, held_within=1.0).encoder
            if (np.abs(target - controller.kinematics.forward(q)[1]) > bound).any():
                inside.clear()
                return False
            inside.append(convert_to_nanoseconds(user.truth.header.stamp))
            return inside[-1] - inside[0] > NANOSECONDS // 2

        words = [sys.executable, str(EXAMPLES / "move_tool.py"), *map(repr, target.tolist())]
        with example("my_servo"):
            with subprocess.Popen(words) as sender:
                user.wait("the tool at its target", settled)
            assert sender.returncode == 0
            # A node of another maker is not missing.
            monkeypatch.setattr(status, "NAMED_WITHIN", PATIENCE)
            # It waits so long for the health of a servo of ours, which there is not.
            code, out, errors = command("status", "--json", "--timeout", "10")
        nodes = json.loads(out)["nodes"]
        assert nodes["servo"]["level"] == "other" and "/my_servo" in nodes["servo"]["message"], out
        assert code == 0 and nodes["emulator"]["level"] == "ok", out + errors


@pytest.mark.parametrize(
    "words", ["", "0.4 0.5", "0.4 0.5 0.6 0.7", "0.4 O.5 0.6", "0,4 0.5 0.6", "0.4 nan 0.6"]
)
def test_a_target_that_is_mistyped_is_a_line(words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["move_tool.py", *words.split()])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(EXAMPLES / "move_tool.py"), run_name="__main__")
    rule = "move_tool: the target must be three finite numbers, x y z [m], got"
    assert end.value.code == f"{rule} {words or 'none'}"


def test_a_motion_controller_of_ones_own_swings_the_waist(tmp_path: Path) -> None:
    observed: dict[float, np.ndarray] = {}  # true joint angles at logical times

    def swung() -> bool:
        """Whether a swing was seen, of 2 s, and how the next one begins."""
        if user.truth is not None:
            t = convert_to_nanoseconds(user.truth.header.stamp) / NANOSECONDS
            observed[t] = np.array(user.truth.position)
        return len(observed) > 0 and max(observed) - min(observed) > 2.5

    with (
        network(tmp_path, only=("emulator", "servo"), start="first_answer") as (user, _),
        example("my_motion_controller"),
    ):
        user.wait("the swing", swung)
    t, q = np.array(list(observed)), np.array(list(observed.values()))
    expected = 0.2 * (1.0 - np.cos(np.pi * t))
    # Targets are held for 50 ms, and the servo (position gain 30/s) is 33 ms behind, at up to
    # 0.63 rad/s; the first step finds it at rest.
    assert np.abs(q[:, 0] - expected).max() < 0.63 * 0.1
    assert q[:, 0].min() < 0.05 and q[:, 0].max() > 0.35
    # The others stand, but for the waist's centrifugal pull.
    assert np.abs(q[:, 1:] - load_scene("three_axis").start[1:]).max() < 1e-3
