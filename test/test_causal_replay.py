"""Bags of a network replayed into one of its nodes: an answer to each message, the same bits."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, BinaryIO

import pytest
from draws import some
from geometry_msgs.msg import PoseStamped
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from mcap.writer import Writer
from network import PATIENCE, network, node
from rclpy.serialization import deserialize_message, serialize_message
from test_command_line import run

from arm_emulator.base.config_files import config_folder
from arm_emulator.ros import causal_replay
from arm_emulator.ros.bag import Bag
from arm_emulator.ros.message_types import message_class
from arm_emulator.ros.node_shell import nanoseconds_of, stamp
from arm_emulator.ros.ros_domain import own_domain
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
        target.header.stamp = stamp(100_000_000)
        p, o = target.pose.position, target.pose.orientation
        (p.x, p.y, p.z), o.w = (0.6, 0.1, 0.3), 1.0  # reached or not, the arm moves
        user.publish(user.tool_targets, target)
        taken = "the target's acceptance"
        user.wait(taken, lambda: user.value("motion_controller", "tool targets") == "1")
        assert user.call("emulator/pause", False).success
        user.wait("some motion", lambda: user.tick > TICKS)
    return bag


class Copy:
    """A bag that gets messages of another one.

    Args:
        file: of the bag.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._writer = Writer(file)
        self._writer.start()
        self._schemas, self._channels = dict[int, int](), dict[int, int]()

    def add(
        self, schema: Schema, channel: Channel, data: bytes, logged: int, published: int
    ) -> None:
        """Write a message of a channel of the other bag, with times [ns]."""
        if channel.id not in self._channels:
            if schema.id not in self._schemas:
                known = self._writer.register_schema(schema.name, schema.encoding, schema.data)
                self._schemas[schema.id] = known
            self._channels[channel.id] = self._writer.register_channel(
                channel.topic,
                channel.message_encoding,
                self._schemas[schema.id],
                channel.metadata,
            )
        self._writer.add_message(self._channels[channel.id], logged, data, published)

    def finish(self) -> None:
        """Write the end of the file."""
        self._writer.finish()


def replayed(bag: Path, into: str) -> tuple[int, dict[str, Any], str]:
    code, out, errors = run("replay", str(bag), "--into", into, "--json")
    return code, json.loads(out), errors


def gains(name: str) -> str:
    return str(config_folder() / f"{name}/three_axis.yaml")


def test_the_record_has_what_replays_into_the_nodes_need(bag: Path) -> None:
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


def test_answers_recorded_long_before_the_first_question_do_not_matter(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recorder that finds the servo long before the emulator, which is reset afterwards."""
    monkeypatch.setattr(causal_replay, "AHEAD", 100)
    late = tmp_path / "late"
    late.mkdir()
    with (
        (late / "late_0.mcap").open("wb") as file,
        next(bag.glob("*.mcap")).open("rb") as recorded,
    ):
        copy = Copy(file)
        whole = list(make_reader(recorded).iter_messages(log_time_order=False))
        earlier = [one for one in whole if one[1].topic == "/motor_commands"]
        shift = 1_000_000_000_000
        for before, messages in ((shift, earlier), (0, whole)):
            for schema, channel, one in messages:
                data = one.data
                if before:  # of a run that went farther
                    command = deserialize_message(data, MotorCommand)
                    command.tick += 10 * TICKS
                    data = serialize_message(command)
                copy.add(schema, channel, data, one.log_time - before, one.publish_time - before)
        copy.finish()
    with own_domain(), node("servo_node.node", "--params-file", gains("servo")):
        code, facts, errors = replayed(late, "servo")
    assert code == 0 and facts["missed"] is None, errors
    assert facts["answers"] == facts["messages"] == facts["alike"] >= TICKS, facts


def test_a_recorder_that_ends_before_the_last_joint_targets_loses_no_answer(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bag has a motion period's first states and answers, and not the targets for them."""
    monkeypatch.setattr(causal_replay, "PATIENCE", 10.0)
    last = 500  # a motion period begins
    cut = tmp_path / "cut"
    cut.mkdir()
    with (cut / "cut_0.mcap").open("wb") as file, next(bag.glob("*.mcap")).open("rb") as recorded:
        copy = Copy(file)
        for schema, channel, one in make_reader(recorded).iter_messages(log_time_order=False):
            message = deserialize_message(one.data, message_class(schema.name))
            header = getattr(message, "header", None)
            after = header is not None and nanoseconds_of(header.stamp) > (last + 3) * 1_000_000
            lost = channel.topic == "/joint_targets" and (
                nanoseconds_of(message.header.stamp) == last * 1_000_000
            )
            if not (after or lost):
                copy.add(schema, channel, one.data, one.log_time, one.publish_time)
        copy.finish()
    with own_domain(), node("servo_node.node", "--params-file", gains("servo")):
        code, facts, errors = replayed(cut, "servo")
    assert code == 0 and facts["missed"] is None, errors
    assert facts["answers"] == facts["messages"] == facts["alike"] == last, facts


def test_a_servo_with_another_gain_answers_each_state_with_the_same_bits(bag: Path) -> None:
    other = [f"joints.{name}.position_gain:=21.0" for name in ("waist", "shoulder", "elbow")]
    words = [word for gain in other for word in ("-p", gain)]
    digests = set()
    with own_domain(), node("servo_node.node", "--params-file", gains("servo"), *words):
        for _ in some(range(10), 3):
            code, facts, errors = replayed(bag, "servo")
            assert code == 0 and facts["answers"] == facts["messages"], errors
            assert facts["alike"] < facts["messages"] and facts["first_other"], facts
            digests.add(facts["digest"])
    assert len(digests) == 1, "the same bits"


def test_answers_that_are_missing_are_reported(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(causal_replay, "PATIENCE", 0.5)
    renamed = config_folder() / "servo/three_axis.yaml"
    text = renamed.read_text().replace("elbow", "knee")
    other = bag.parent / "knee.yaml"
    other.write_text(text)
    with own_domain(), node("servo_node.node", "--params-file", str(other)):
        code, facts, errors = replayed(bag, "servo")
    assert code == 1 and facts["answers"] == 0 and facts["messages"] >= TICKS
    assert f"{facts['messages']} answers are missing, from t = 0 s" in str(facts["missed"])
    assert "replay: goal not reached: " in errors


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
