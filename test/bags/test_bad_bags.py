"""Bags that cannot be checked, and words that are refused."""

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from made_bags import TYPES, synthetic
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from test_bags import run

from arm_emulator.bags import recorded_topics
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.commands.check_bag import check_bag
from arm_emulator.cli.commands.replay import choose_publishing_qos, replay_bag
from arm_emulator.ros.messages.message_types import get_message_class
from arm_emulator.ros.recording.bag_metadata import Topic
from arm_emulator.ros.recording.bag_writer import BagWriter
from arm_emulator.ros.recording.recorder import choose_qos
from arm_emulator_analysis.commands.explain import explain_run


def damaged(folder: Path) -> Path:
    bag = synthetic(folder, [True] * 50)
    file = bag / f"{folder.name}_0.mcap"
    data = bytearray(file.read_bytes())
    data[len(data) // 4] ^= 1
    file.write_bytes(data)
    return bag


def foreign_topics(folder: Path) -> Path:
    with BagWriter(folder) as writer:
        number = writer.add_topic(Topic("/talk", "std_msgs/msg/String"))
        writer.write_message(number, 1, 1, serialize_message(String(data="hello")))
    return folder


def changed_definition(folder: Path) -> Path:
    with BagWriter(folder) as writer:
        for topic, kind in TYPES.items():
            name = f"arm_emulator_msgs/msg/{kind.__name__}"
            number = writer.add_topic(Topic(topic, name, "uint64 tick\nfloat32[] value\n"))
            writer.write_message(number, 1, 1, serialize_message(kind()))
    return folder


def empty_folder(folder: Path) -> Path:
    folder.mkdir()
    return folder


def sqlite_storage(folder: Path) -> Path:
    folder.mkdir()
    (folder / "bag_0.db3").write_bytes(b"SQLite format 3\0")
    return folder


def text_file(folder: Path) -> Path:
    file = folder.with_suffix(".mcap")
    file.write_text("this is not a bag\n")
    return file


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda folder: folder, "the bag must exist"),
        (empty_folder, "the bag must hold *.mcap files"),
        (sqlite_storage, "the bag's storage must be mcap, got sqlite3 (*.db3)"),
        (lambda folder: sqlite_storage(folder) / "bag_0.db3", "must be mcap, got sqlite3"),
        (text_file, "the bag must be undamaged MCAP"),
        (damaged, "the bag must be undamaged MCAP"),
        (foreign_topics, "the bag must have one topic motor_states, got /talk"),
        (changed_definition, "must be the arm_emulator_msgs/msg/MotorCommand of this version"),
    ],
)
def test_bad_bags_are_refused(make: Callable[[Path], Path], words: str, tmp_path: Path) -> None:
    bag = make(tmp_path / "bag")
    with pytest.raises(Refusal, match=re.escape(words)) as refusal:
        check_bag(bag, scene="three_axis")
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("check-bag", "nothing"), "nothing: the bag must exist"),
        (("replay", "nothing"), "nothing: the bag must exist"),
        (("replay", "nothing", "--rate", "0"), "replay: rate must be > 0 and finite, got 0.0"),
        (("record", "."), "record: folder . must be new"),
    ],
)
def test_refusals_are_a_line_and_exit_code_2(arguments: tuple[str, ...], words: str) -> None:
    code, printed = run(*arguments)
    assert code == 2
    assert printed.startswith(words) and printed.count("\n") == 1


def test_a_topic_that_is_not_in_the_bag_is_refused(tmp_path: Path) -> None:
    code, printed = run("replay", foreign_topics(tmp_path / "bag"), "--topics", "walk")
    assert code == 2
    assert "--topics must be in the bag, got /walk; valid: /talk" in printed


def test_a_replay_of_no_message_is_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(Topic("/talk", "std_msgs/msg/String"))
    with pytest.raises(Refusal, match="the bag must hold messages, got none"):
        replay_bag(tmp_path / "bag")


def test_a_bag_of_a_missing_scene_is_refused_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = synthetic(tmp_path / "bag", [True] * 2)
    monkeypatch.setattr(recorded_topics, "find_config_folder", lambda: tmp_path)
    rule = f"{bag}: --scene must name the scene with the joints waist, shoulder, elbow, got none"
    for command in (check_bag, partial(explain_run, at=0.0)):
        with pytest.raises(Refusal, match=re.escape(rule)):
            command(bag)


def test_unknown_message_types_are_refused() -> None:
    for kind in (
        "nobody_msgs/msg/Word",
        "std_msgs/msg/Word",
        "std_msgs/msg/__name__",
        "std_msgs",
        "",
    ):
        with pytest.raises(Refusal, match="be installed"):
            get_message_class(kind)


def test_a_recorder_requests_the_qos_that_all_publishers_offer() -> None:
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    hasty = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    assert choose_qos([latched]).durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert choose_qos([latched, hasty]).durability == DurabilityPolicy.VOLATILE
    assert choose_qos([latched, hasty]).reliability == ReliabilityPolicy.BEST_EFFORT
    # And a replay offers what serves the listeners of each.
    assert choose_publishing_qos([latched, hasty]).durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert choose_publishing_qos([latched, hasty]).reliability == ReliabilityPolicy.RELIABLE
    assert choose_publishing_qos([hasty]).reliability == ReliabilityPolicy.BEST_EFFORT
    manual = QoSProfile(depth=1, liveliness=LivelinessPolicy.MANUAL_BY_TOPIC)
    assert choose_publishing_qos([manual]).liveliness == LivelinessPolicy.MANUAL_BY_TOPIC
