"""Copies of bags in which messages are changed or left out."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from made_bags import TYPES
from rclpy.serialization import deserialize_message, serialize_message

from arm_emulator.ros.recording.bag import Bag, BagMessage
from arm_emulator.ros.recording.bag_metadata import Topic
from arm_emulator.ros.recording.bag_writer import BagWriter


def rewrite(
    bag: Path,
    copy: Path,
    change: Callable[[BagMessage], bytes | None],
    reports_changes: bool = False,
    first: Iterable[BagMessage] = (),
) -> Path:
    """Write a copy in which `change` gives each message's bytes, None to leave it out.

    With `reports_changes` it has a topic of changes by hand, on which none came. It begins with
    the messages `first`.
    """
    original = Bag(bag)
    with BagWriter(copy) as writer:
        numbers = {}
        if reports_changes:
            writer.add_topic(Topic("/emulator/events", "arm_emulator_msgs/msg/MachineEvent"))
        for name, topic in original.topics.items():
            new = Topic(topic.name, topic.type, topic.definition, topic.offered, topic.type_hash)
            numbers[name] = writer.add_topic(new)
        for message in first:
            writer.write_message(
                numbers[message.topic], message.received, message.published, message.data
            )
        for message in original.read_messages():
            data = change(message)
            if data is not None:
                writer.write_message(
                    numbers[message.topic], message.received, message.published, data
                )
    return copy


def changed(
    topic: str, kind: Any, meant: Callable[[Any], bool], change: Callable[[Any], None]
) -> Callable[[BagMessage], bytes]:
    """Change the messages of a topic that are meant."""

    def rewritten(bag_message: BagMessage) -> bytes:
        if bag_message.topic != topic:
            return bag_message.data
        message = deserialize_message(bag_message.data, kind)
        if meant(message):
            change(message)
        return serialize_message(message)

    return rewritten


def flip(
    topic: str, kind: Any, tick: int, quantity: str, bit: int = 0
) -> Callable[[BagMessage], bytes]:
    """Flip a bit, the lowest by default, of the elbow's value in a tick's messages."""

    def meant(message: Any) -> bool:
        stamp = message.header.stamp
        at = getattr(message, "tick", (stamp.sec * 10**9 + stamp.nanosec) // 10**6)
        return bool(at == tick)

    def change(message: Any) -> None:
        np.frombuffer(getattr(message, quantity), dtype=np.int64)[2] ^= 1 << bit

    return changed(topic, kind, meant, change)


def without(topics: Iterable[str], lost: Callable[[int], bool]) -> Callable[[BagMessage], Any]:
    """Leave out messages of topics by their ticks."""

    def change(bag_message: BagMessage) -> bytes | None:
        tick = (
            bag_message.topic in topics
            and deserialize_message(bag_message.data, TYPES[bag_message.topic]).tick
        )
        return None if bag_message.topic in topics and lost(int(tick)) else bag_message.data

    return change
