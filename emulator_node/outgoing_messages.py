"""Outgoing messages of the emulator: published, and written into its own record."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message

if TYPE_CHECKING:
    from arm_emulator.ros.run_record import RunRecord


class OutgoingMessages:
    """Outgoing messages of Python.

    Attributes:
        record: record of published and accepted messages; None: no record.
        before_record: called before a message is written into it, to write those of C.
    """

    def __init__(self) -> None:
        self.record: RunRecord | None = None
        self.before_record: Callable[[], None] = lambda: None

    def put(self, publisher: Publisher, message: Any) -> None:
        """Publish a message, or the bytes of one, and write it into the record."""
        if self.record is None:
            publisher.publish(message)
            return
        data = message if isinstance(message, bytes) else serialize_message(message)
        self.before_record()
        self.record.put(publisher.topic_name, data)
        publisher.publish(data)

    def record_other(self, topic: str, data: bytes) -> None:
        """Write a message of another node into the record, if there is one."""
        if self.record is not None:
            self.before_record()
            self.record.put(topic, data)

    def close(self) -> None:
        """Finish the record."""
        if self.record is not None:
            self.record.close()


def own_record(
    node: Node, folder: Path, publishers: list[Publisher], taken: list[str], lockstep: bool
) -> RunRecord:
    """Return a new record of a node's messages, and of topics to which it has subscribed.

    Raises:
        Refusal: the folder cannot be written.
    """
    # Imported only if needed: a stock ROS 2 machine may have no package for bags.
    from arm_emulator.ros.bag_metadata import Topic
    from arm_emulator.ros.message_types import definition_of
    from arm_emulator.ros.run_record import RunRecord

    ends = [
        (publisher.topic_name, node.get_publishers_info_by_topic(publisher.topic_name))
        for publisher in publishers
    ]
    ends += [(name, node.get_subscriptions_info_by_topic(name)) for name in taken]
    topics = []
    for name, known in ends:
        kind, offered = known[0].topic_type, tuple(one.qos_profile for one in known)
        kind_hash = str(known[0].topic_type_hash)
        topics.append(Topic(name, kind, definition_of(kind), offered, kind_hash))
    return RunRecord(folder, topics, lockstep)
