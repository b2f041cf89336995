"""Outgoing messages of the emulator: published, and written into its own record."""

from __future__ import annotations

import threading
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message

from arm_emulator.ros.node_shell import Diagnostics

if TYPE_CHECKING:
    from arm_emulator.ros.run_record import RunRecord

UNPUBLISHED = 1000  # messages that may wait in real time: a controller needs the newest ones


class Outbox:
    """Queue of outgoing messages.

    The thread that takes the ticks of a loop writes messages to the record at once and queues them
    here, because publishing takes longer; `send` publishes them.

    Attributes:
        record: record of published and accepted messages; None: no record.
        taker: that thread.
    """

    def __init__(self, diagnostics: Diagnostics) -> None:
        self.record: RunRecord | None = None
        self.taker: threading.Thread | None = None
        self._diagnostics = diagnostics
        self._waiting: deque[tuple[Publisher, bytes]] = deque()
        self._too_late = 0  # messages dropped for newer ones

    def put(self, publisher: Publisher, message: Any) -> None:
        """Publish a message, or the bytes of one, and write it into the record."""
        if self.record is None and self.taker is None:
            publisher.publish(message)
            return
        data = message if isinstance(message, bytes) else serialize_message(message)
        if self.record is not None:
            self.record.put(publisher.topic_name, data)
        if threading.current_thread() is not self.taker:
            publisher.publish(data)
            return
        if len(self._waiting) >= UNPUBLISHED:
            self._waiting.popleft()
            self._too_late += 1
            self._diagnostics.values["messages too late to publish"] = self._too_late
        self._waiting.append((publisher, data))

    def send(self, most: int = UNPUBLISHED) -> bool:
        """Publish waiting messages, oldest first, up to a number; return whether more wait."""
        for _ in range(min(most, len(self._waiting))):
            publisher, data = self._waiting.popleft()
            publisher.publish(data)
        return bool(self._waiting)

    def close(self) -> None:
        """Finish the record."""
        if self.record is not None:
            self.record.close()


def own_record(
    node: Node, folder: Path, publishers: list[Publisher], commands: str, lockstep: bool
) -> RunRecord:
    """Return a new record of a node's messages, and of the topic of its commands.

    Raises:
        Refusal: the folder cannot be written.
    """
    # Imported only if needed: a stock ROS 2 machine may have no package for bags.
    from arm_emulator.ros.bag_metadata import Topic
    from arm_emulator.ros.message_types import definition_of
    from arm_emulator.ros.run_record import RunRecord

    ends = [
        (one.topic_name, node.get_publishers_info_by_topic(one.topic_name)) for one in publishers
    ]
    ends.append((commands, node.get_subscriptions_info_by_topic(commands)))
    topics = []
    for name, known in ends:
        kind, offered = known[0].topic_type, tuple(one.qos_profile for one in known)
        kind_hash = str(known[0].topic_type_hash)
        topics.append(Topic(name, kind, definition_of(kind), offered, kind_hash))
    return RunRecord(folder, topics, lockstep)
