"""`move` and `status` beside a running network, and without one."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from geometry_msgs.msg import PoseStamped
from network import PATIENCE, assert_same_bits, network, offline_states
from node_parameters import Parameters
from rclpy.context import Context
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from test_command_line import run

from arm_emulator.cli.commands import move, status
from arm_emulator.motion.model.pose import Pose
from arm_emulator.ros.node.network_client import NetworkClient
from arm_emulator.ros.node.node_shell import COMMAND_QOS, EVENT_QOS
from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator.ros.recording import recorded_publisher
from arm_emulator.runs.offline import load_offline_run
from arm_emulator_msgs.msg import EmulatorStatus, MotionStatus, RecorderReport


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands in this process find nodes on a busy machine, too."""
    monkeypatch.setattr(move, "PATIENCE", PATIENCE)
    monkeypatch.setattr(status, "NAMED_WITHIN", PATIENCE)


@pytest.mark.slow
def test_a_target_is_sent_and_its_end_is_the_exit_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with network(tmp_path / "log", clock="realtime", start="first_answer") as (user, _):
        # A busy machine may keep the motion controller from computing for seconds of real time.
        refused = Parameters(user).set("servo", hold_after=50.0, cut_after=100.0)
        assert not refused, refused
        user.wait("the run", lambda: user.tick > 20)
        code, out, errors = run("move", "--by", "0.01", "0", "0")
        lines = out.splitlines()
        assert code == 0, out + errors
        assert [line.split(",")[0] for line in lines] == ["accepted", "moving", "reached"], out
        assert float(lines[-1].split()[1]) < 1.0, "mm left, of the 10"

        code, out, errors = run("move", "--joints", "waist=0.2", "--json")
        facts = json.loads(out)
        assert code == 0 and facts["states"] == ["accepted", "moving", "reached"], errors
        monkeypatch.setattr(status, "TARGET_WITHIN", PATIENCE)  # there is one
        monkeypatch.setattr(status, "OTHERS_WITHIN", 2.0)
        code, out, _ = run("status", "--json", "--timeout", "60")
        facts = json.loads(out)
        assert code == 0 and facts["target"]["state"] == "reached", out
        assert abs(facts["joints"]["waist"] - 0.2) < 2e-3, "the joint is where it was sent"
        assert {value["level"] for value in facts["nodes"].values()} == {"ok"}
        assert not facts["target"]["before_reset"]
        assert user.call("emulator/reset").success
        target = json.loads(run("status", "--json", "--timeout", "60")[1])["target"]
        assert target["before_reset"] and target["state"] == "reached", "it is no more the newest"

        code, out, _ = run("move", "--to", "50", "0", "0")
        assert code == 1 and out.splitlines()[-1].startswith("unreachable"), out
        code, out, _ = run("move", "--joints", "waist=1e9")
        assert code == 1 and "refused: " in out, out
        code, out, errors = run("move", "--joints", "knee=1")
        assert code == 2 and "must name joints, got knee; valid: waist" in errors, errors
        code, out, errors = run("move", "--by", "0", "0", "1e-3", "--timeout", "1e-3")
        assert code == 1 and "no end within 0.001 s" in out, out


@pytest.mark.slow
def test_without_a_network_a_line_names_the_remedy() -> None:
    with own_domain():
        started = {
            words: subprocess.Popen(
                [sys.executable, "-m", "arm_emulator", *words],
                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            )
            for words in (("move", "--by", "0", "0", "0.1"), ("status", "--timeout", "0.1"))
        }  # fmt: skip
        codes = {"move": 2, "status": 1}
        for words, process in started.items():
            out, errors = process.communicate(timeout=60.0)
            assert process.returncode == codes[words[0]], errors
            assert "start " in out + errors and "`arm_emulator up`" in out + errors
            assert errors.count("\n") == (words[0] == "move"), errors


@pytest.mark.parametrize("late", ["recorder", "emulator"])
def test_a_target_is_sent_when_all_that_record_it_listen(
    late: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They begin to listen long after the motion controller; `move` would have sent it by then."""
    monkeypatch.setattr(recorded_publisher, "PATIENCE", PATIENCE)
    heard: list[PoseStamped] = []
    with own_domain():
        context = Context()
        context.init()
        try:
            sender = NetworkClient("move", "", context)
            nodes = {
                name: Node(name, context=context)
                for name in ("emulator", "recorder", "motion_controller")
            }
            for node in nodes.values():
                sender.executor.add_node(node)
            nodes["emulator"].declare_parameter("record", "bag" if late == "emulator" else "")
            nodes["emulator"].create_publisher(EmulatorStatus, "emulator/status", 1)
            nodes["recorder"].create_publisher(RecorderReport, "emulator/recorders", 1)
            nodes["motion_controller"].create_publisher(MotionStatus, "motion/status", EVENT_QOS)

            def listen(node: Node, hear: Callable[[PoseStamped], object]) -> None:
                node.create_subscription(PoseStamped, "tool_target", hear, COMMAND_QOS)

            def listen_late() -> None:
                timer.cancel()
                listen(nodes[late], heard.append)

            for name in nodes.keys() - {late}:
                listen(nodes[name], lambda _: None)
            timer = nodes[late].create_timer(1.0, listen_late)
            publisher = sender.create_publisher(PoseStamped, "tool_target", COMMAND_QOS)
            sender.newest["clock"] = Clock()
            kind = MotionStatus.KIND_TOOL_TARGET
            move._watch_goal(sender, publisher, PoseStamped(), kind, None, timeout=0.1)
            assert sender.spin_until(lambda: bool(heard), 5.0)
        finally:
            context.try_shutdown()


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("move",), "the target must be one, got none"),
        (("move", "--by", "0", "0", "0", "--joints", "a=1"), "got --by and --joints"),
        (("move", "--joints", "a"), "--joints must be NAME=ANGLE"),
        (("move", "--joints", "a=nan"), "--joints must be NAME=ANGLE"),
        (("move", "--joints", "a=1", "--seconds", "0"), "--seconds must be > 0"),
        (("move", "--by", "0", "0", "0", "--at", "0"), "--at must be > 0 s"),
        (("move", "--by", "0", "0", "0", "--namespace", "a b"), "--namespace must be a name"),
        (("move", "--by", "0", "0", "0", "--timeout", "nan"), "--timeout must be >= 0 s, got nan"),
        (("status", "--timeout", "nan"), "--timeout must be >= 0 s, got nan"),
    ],
)
def test_malformed_targets_are_refused(
    words: tuple[str, ...], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, errors = run(*words)
    assert code == 2 and not out and errors.count("\n") == 1 and reason in errors, errors


@pytest.mark.slow
def test_a_target_with_a_time_gives_the_bits_of_every_repeated_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The truth is a run in one process with the same target at the same time."""
    offline = load_offline_run("three_axis")
    x, y, z = offline.controller.kinematics.forward(offline.session.scene.start)[1].tolist()
    there = (x, y + 0.03, z)
    with network(tmp_path / "log", start="paused") as (user, _):
        user.await_start()
        errors = ""
        for patience in (1.0, 10.0):  # all of it: a position never comes, only the clock does
            with monkeypatch.context() as brief:
                brief.setattr(move, "PATIENCE", patience)
                code, _, errors = run("move", "--by", "0", "0", "0.1", "--at", "0.2")
            if "position of an arm" in errors:
                break
        assert code == 2 and "position of an arm that stands must be known" in errors
        words = ["move", "--to", *map(str, there), "--quaternion", "0", "0", "0", "1"]
        with subprocess.Popen(
            [sys.executable, "-m", "arm_emulator", *words, "--at", "0.2"]
        ) as sender:
            taken = "the target's acceptance"
            user.wait(taken, lambda: user.value("motion_controller", "tool targets") == "1")
            assert user.call("emulator/pause", False).success
            assert sender.wait(120.0) == 0
        user.wait("the motion", lambda: user.tick > 1500)
        code, _, errors = run("move", "--to", *map(str, there), "--at", "0.2")
        assert code == 2 and "--at must be later than logical time" in errors
        offline.instructor.add(200_000_000, Pose.from_quaternion(there, (0.0, 0.0, 0.0, 1.0)))
        assert_same_bits(user.motor_states(), offline_states(offline, 1500), 1500)
