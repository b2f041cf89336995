"""Outgoing messages of the emulator, and its own record of them and of what other nodes publish."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from rclpy.subscription import Subscription

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.messages.message_types import get_message_class, read_definition
from arm_emulator.ros.messages.node_topics import OF_OTHERS, TYPES
from arm_emulator.ros.node.entities import take_message
from arm_emulator.ros.node.node_shell import COMMAND_QOS

if TYPE_CHECKING:
    from arm_emulator.ros.recording.run_record import RunRecord


class OutgoingMessages:
    """Outgoing messages of Python.

    Attributes:
        record: record of published and accepted messages; None: no record.
        before_record: called before a message is written into it, to write those of C.
    """

    def __init__(self) -> None:
        self.record: RunRecord | None = None
        self.before_record: Callable[[], None] = lambda: None

    def publish_message(self, publisher: Publisher, message: Any) -> None:
        """Publish a message, or the bytes of one, and write it into the record."""
        if self.record is None:
            publisher.publish(message)
            return
        data = message if isinstance(message, bytes) else serialize_message(message)
        self.before_record()
        self.record.add_message(publisher.topic_name, data)
        publisher.publish(data)

    def record_message_of_others(self, topic: str, data: bytes) -> None:
        """Write a message of another node into the record, if there is one."""
        if self.record is not None:
            self.before_record()
            self.record.add_message(topic, data)

    def close(self) -> None:
        """Finish the record."""
        if self.record is not None:
            self.record.close()


def create_record(
    node: Node, folder: Path, publishers: list[Publisher], taken: list[str], lockstep: bool
) -> RunRecord:
    """Return a new record of a node's messages, and of topics to which it has subscribed.

    Raises:
        Refusal: the folder cannot be written.
    """
    # Imported only if needed: a stock ROS 2 machine may have no package for bags.
    from arm_emulator.ros.recording.bag_metadata import Topic
    from arm_emulator.ros.recording.run_record import RunRecord

    ends = [
        (publisher.topic_name, node.get_publishers_info_by_topic(publisher.topic_name))
        for publisher in publishers
    ]
    ends += [(name, node.get_subscriptions_info_by_topic(name)) for name in taken]
    topics = []
    for name, endpoints in ends:
        kind, offered = (
            endpoints[0].topic_type,
            tuple(endpoint.qos_profile for endpoint in endpoints),
        )
        kind_hash = str(endpoints[0].topic_type_hash)
        topics.append(Topic(name, kind, read_definition(kind), offered, kind_hash))
    return RunRecord(folder, topics, lockstep)


def subscribe_to_others(node: Node, put: Callable[[str, bytes], None]) -> list[Subscription]:
    """Subscribe to what a replay of servo or motion controller needs.

    Args:
        node: the emulator's.
        put: gets topic and bytes of each message.
    """
    subscriptions = []
    for name in OF_OTHERS:
        with contextlib.suppress(Refusal):  # no such package, so no node publishes it
            topic = node.resolve_topic_name(name)
            kind = get_message_class(TYPES[name])
            # As many as publishers keep: the record may be behind for a moment.
            subscriptions.append(
                node.create_subscription(kind, topic, partial(put, topic), COMMAND_QOS, raw=True)
            )
    return subscriptions


def take_rest(subscriptions: Iterable[Subscription]) -> None:
    """Take the messages that have come by now, as many as wait at most."""
    for subscription in subscriptions:
        for _ in range(COMMAND_QOS.depth):
            if not take_message(subscription):
                break
