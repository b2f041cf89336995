"""Bags of a network replayed into one of its nodes: an answer to each message, the same bits."""

import json
from pathlib import Path
from typing import Any

import pytest
from draws import some
from geometry_msgs.msg import PoseStamped
from network import PATIENCE, network, node
from rclpy.serialization import deserialize_message, serialize_message
from rewritten_bags import rewrite
from test_command_line import run

from arm_emulator.base.io.config_files import find_config_folder
from arm_emulator.ros.messages.message_types import get_message_class
from arm_emulator.ros.messages.time_stamp import convert_to_nanoseconds, convert_to_stamp
from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator.ros.recording import causal_replay, replay_messages
from arm_emulator.ros.recording.bag import Bag, BagMessage
from arm_emulator_msgs.msg import MotorCommand

TICKS = 600  # 12 motion periods


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replays begin beside the nodes, whose imports take long on a busy machine."""
    monkeypatch.setattr(causal_replay, "DISCOVERY", PATIENCE)
    monkeypatch.setattr(causal_replay, "PATIENCE", PATIENCE)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The emulator's own record of a network that was given a target."""
    folder = tmp_path_factory.mktemp("recorded")
    bag = folder / "bag"
    with network(folder / "log", start="paused", record=bag) as (user, _):
        user.await_start()
        target = PoseStamped()
        target.header.stamp = convert_to_stamp(100_000_000)
        p, o = target.pose.position, target.pose.orientation
        (p.x, p.y, p.z), o.w = (0.6, 0.1, 0.3), 1.0  # reached or not, the arm moves
        user.publish(user.tool_targets, target)
        taken = "the target's acceptance"
        user.wait(taken, lambda: user.value("motion_controller", "tool targets") == "1")
        assert user.call("emulator/pause", False).success
        user.wait("some motion", lambda: user.tick > TICKS)
    return bag


def replayed(bag: Path, into: str) -> tuple[int, dict[str, Any], str]:
    code, out, errors = run("replay", str(bag), "--into", into, "--json")
    return code, json.loads(out), errors


def gains(name: str) -> str:
    return str(find_config_folder() / f"{name}/three_axis.yaml")


@pytest.mark.slow
def test_the_record_has_the_topics_that_replays_need(bag: Path) -> None:
    counts = {name: topic.count for name, topic in Bag(bag).topics.items()}
    for name in ("joint_targets", "joint_states", "servo_states"):
        assert counts[f"/{name}"] >= TICKS // 50, counts
    assert counts["/tool_target"] == 1 and counts["/motion/status"] >= 2


def test_the_recorded_nodes_give_the_recorded_bits(bag: Path) -> None:
    """The truth is the network: each answer in the bag was made beside the other two nodes."""
    for into, module, kind in (
        ("servo", "servo_node.node", "servo"),
        ("motion_controller", "motion_controller_node.node", "motion"),
    ):
        with own_domain(), node(module, "--params-file", gains(kind)):
            code, facts, errors = replayed(bag, into)
        assert code == 0 and facts["missed"] is None, errors
        assert facts["answers"] == facts["messages"] == facts["alike"], facts
        assert facts["messages"] >= (TICKS if into == "servo" else TICKS // 50), facts


@pytest.mark.slow
def test_commands_recorded_long_before_the_first_state_do_not_matter(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recorder that finds the servo long before the emulator, which is reset afterwards."""
    for module in (causal_replay, replay_messages):
        monkeypatch.setattr(module, "AHEAD", 100)
    shift, earlier = 1_000_000_000_000, list[BagMessage]()
    for message in Bag(bag).read_messages(["/motor_commands"]):
        command = deserialize_message(message.data, MotorCommand)
        command.tick += 10 * TICKS  # of a run that went farther
        earlier.append(
            BagMessage(
                message.topic,
                message.received - shift,
                message.published - shift,
                serialize_message(command),
            )
        )
    late = rewrite(bag, tmp_path / "late", lambda message: message.data, first=earlier)
    with own_domain(), node("servo_node.node", "--params-file", gains("servo")):
        code, facts, errors = replayed(late, "servo")
    assert code == 0 and facts["missed"] is None, errors
    assert facts["answers"] == facts["messages"] == facts["alike"] >= TICKS, facts


@pytest.mark.slow
def test_a_recorder_that_ends_before_the_last_joint_targets_loses_no_answer(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bag has a motion period's first states and answers, and not the targets for them."""
    monkeypatch.setattr(causal_replay, "PATIENCE", 10.0)
    last = 500  # a motion period begins
    kinds = {name: get_message_class(topic.type) for name, topic in Bag(bag).topics.items()}

    def recorded(message: BagMessage) -> bytes | None:
        header = getattr(deserialize_message(message.data, kinds[message.topic]), "header", None)
        at = None if header is None else convert_to_nanoseconds(header.stamp)
        after = at is not None and at > (last + 3) * 1_000_000
        lost = message.topic == "/joint_targets" and at == last * 1_000_000
        return None if after or lost else message.data

    cut = rewrite(bag, tmp_path / "cut", recorded)
    with own_domain(), node("servo_node.node", "--params-file", gains("servo")):
        code, facts, errors = replayed(cut, "servo")
    assert code == 0 and facts["missed"] is None, errors
    assert facts["answers"] == facts["messages"] == facts["alike"] == last, facts


@pytest.mark.slow
def test_a_servo_with_another_gain_responds_to_each_state_with_the_same_bits(bag: Path) -> None:
    second = [f"joints.{name}.position_gain:=21.0" for name in ("waist", "shoulder", "elbow")]
    words = [word for gain in second for word in ("-p", gain)]
    digests = set()
    with own_domain(), node("servo_node.node", "--params-file", gains("servo"), *words):
        for _ in some(range(10), 3):
            code, facts, errors = replayed(bag, "servo")
            assert code == 0 and facts["answers"] == facts["messages"], errors
            assert facts["alike"] < facts["messages"] and facts["first_other"], facts
            digests.add(facts["digest"])
    assert len(digests) == 1, "the same bits"


@pytest.mark.slow
def test_missing_commands_are_reported(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(causal_replay, "PATIENCE", 0.5)
    renamed = find_config_folder() / "servo/three_axis.yaml"
    text = renamed.read_text().replace("elbow", "knee")
    second = bag.parent / "knee.yaml"
    second.write_text(text)
    with own_domain(), node("servo_node.node", "--params-file", str(second)):
        code, facts, errors = replayed(bag, "servo")
    assert code == 1 and facts["answers"] == 0 and facts["messages"] >= TICKS
    assert f"{facts['messages']} answers are missing, from t = 0 s" in str(facts["missed"])
    assert "replay: goal not reached: " in errors


@pytest.mark.slow
def test_a_replay_without_its_node_or_beside_an_emulator_is_refused(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with network(tmp_path / "log", start="paused") as (user, _):
        user.await_start()
        code, _, errors = run("replay", str(bag), "--into", "servo")
        assert code == 2 and "must be published by the replay alone" in errors
    monkeypatch.setattr(causal_replay, "DISCOVERY", 0.5)
    with own_domain():
        code, _, errors = run("replay", str(bag), "--into", "servo")
    assert code == 2 and "must be taken by a servo" in errors and "start it" in errors
