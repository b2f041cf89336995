"""Messages of one publisher per topic: of the node whose work the topic is.

rclpy passes nothing about its publisher on with a message, rcl does: its identity, by which the
graph has its node. So these messages are taken through c/middleware.h.
"""

import math
import time
from collections.abc import Callable
from typing import Any, Protocol

from rclpy.callback_groups import CallbackGroup
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.c import MIDDLEWARE
from arm_emulator.ros.messages.middleware import get_middleware
from arm_emulator.toolchain.c_header import CData

# Kinds of nodes, and topics by which such a node is known: it publishes all of them. The first one
# is named in its diagnostics, see `DuplicateNodes`.
KINDS = {
    "emulator": ("motor_states", "emulator/status", "emulator/events"),
    "servo": ("motor_commands", "servo_states", "joint_states"),
    "motion controller": ("joint_targets", "motion/status"),
}
LOOK_AGAIN = 0.25  # s, wall: between two looks at the graph because of one publisher
IDENTIFY = 4.0  # s, wall: for a node that was discovered to be known by its name
WITHHELD_LIMIT = 1000  # messages of topics that keep them for late subscribers
_NO_PUBLISHER = bytes(MIDDLEWARE.get_constant("ROS_GID"))


class OwnExecutorOnly(CallbackGroup):
    """Subscriptions that `LeanExecutor` alone serves: rclpy's executors do not know publishers."""

    def can_execute(self, entity: Any) -> bool:
        """Return whether rclpy's executors may serve an entity: events of a subscription."""
        return not isinstance(entity, Subscription)

    def beginning_execution(self, entity: Any) -> bool:
        """See `CallbackGroup`."""
        return self.can_execute(entity)

    def ending_execution(self, entity: Any) -> None:
        """See `CallbackGroup`."""


def receive_message(subscription: Any, owner: CData | None = None) -> CData | None:
    """Take the oldest message that is not dropped, as ``ros_received``; None if none has come.

    Args:
        subscription: the subscription.
        owner: whose messages are taken, ``ros_publisher *``; None: those of any.
    """
    handle = MIDDLEWARE.ffi.cast("void *", subscription.handle.pointer)
    message = MIDDLEWARE.make_struct("ros_received")
    owner_or_null = MIDDLEWARE.ffi.NULL if owner is None else owner
    return message if get_middleware().ros_receive(handle, owner_or_null, message) else None


def split_received(message: CData) -> tuple[bytes, bytes]:
    """Return the bytes of a ``ros_received``, and its publisher's identity."""
    data = MIDDLEWARE.ffi.buffer(message.data, message.size) if message.size else b""
    return bytes(data), bytes(message.publisher)


class SubscribingNode(Protocol):
    """A node that subscribes, see `ManagedNode`."""

    refuse: Callable[..., None]
    count: Callable[..., None]
    note: Callable[[str, object], None]
    has_lost: Callable[[str, int], bool]

    def resolve_topic_name(self, topic: str) -> str:
        """See `Node`."""

    def get_publishers_info_by_topic(self, topic_name: str) -> list[Any]:
        """See `Node`."""


class SolePublisher:
    """The publisher of a topic whose messages a node takes.

    It belongs to the first node of the kind whose work the topic is. Without such a node it is the
    first publisher of any. It changes when it leaves the graph, when its node of that kind was
    killed, or when such a node joins.

    Attributes:
        owner: ``ros_publisher *``.

    Args:
        node: the node that subscribes; it gets the refusals.
        topic: the topic.
        kind: kind of nodes whose work it is, of `KINDS`.
        keeps: whether the topic keeps messages for late subscribers, which get them once.
    """

    def __init__(self, node: SubscribingNode, topic: str, kind: str, keeps: bool) -> None:
        self._node, self._topic, self._full = node, topic, node.resolve_topic_name(topic)
        self._signs = [node.resolve_topic_name(sign) for sign in KINDS[kind]]
        self._kind, self._keeps = kind, keeps
        self.owner = MIDDLEWARE.make_struct("ros_publisher")
        self._owner = _NO_PUBLISHER
        self._judged_until: dict[bytes, float] = {}  # until when a judgement of a publisher holds
        self._refused, self._refused_name = _NO_PUBLISHER, ""  # the newest one that was refused
        self._refused_at = 0.0  # s, monotonic: when the first message was dropped that is to report
        self.withheld: list[tuple[bytes, bytes]] = []  # messages and publishers

    def is_admitted(self, publisher: bytes) -> bool:
        """Return whether a message of a publisher is to be taken; it is counted if it is not."""
        now = time.monotonic()
        if now >= self._judged_until.get(publisher, 0.0):
            nodes = self._list_nodes()
            is_owner, is_final = self._judge_publisher(publisher, nodes)
            if not is_owner:
                self._refused, self._refused_name = publisher, nodes.get(publisher, "")
                if not self._keeps:  # else they are withheld, each one
                    self.owner.quiet_until = round((now + LOOK_AGAIN) * 1e9)
            elif publisher != self._owner:
                self._take_over(publisher)
            self._judged_until[publisher] = math.inf if is_final else now + LOOK_AGAIN
        if publisher == self._owner:
            return True
        self.owner.dropped += 1
        return False

    def report_dropped(self) -> None:
        """Report messages of others that were dropped since the last time.

        The report waits for the names of both nodes, which the graph may learn some time after
        their messages; for `IDENTIFY` seconds at most.
        """
        if not self.owner.dropped:
            return
        now, nodes = time.monotonic(), self._list_nodes()
        self._refused_at = self._refused_at or now
        if not has_name(self._refused_name):  # else it may have left since
            self._refused_name = nodes.get(self._refused, "")
        name, owner = self._refused_name, nodes.get(self._owner) or self._find_first_of_kind(nodes)
        identified = has_name(name) and has_name(owner)
        if not identified and now - self._refused_at < IDENTIFY:
            return
        dropped, self.owner.dropped, self._refused_at = self.owner.dropped, 0, 0.0
        if self._refused == self._owner:
            self._node.count(f"{self._topic} before the graph had their node", dropped)
            return
        if identified and name == owner:
            self._node.count(f"{self._topic} of another node of the same name", dropped)
            return
        owner_words = f"node {owner}," if has_name(owner) else "the one"
        actual = f"node {name}" if has_name(name) else "a node that the graph does not have yet"
        refusal = Refusal(
            self._topic, "publisher", f"be {owner_words} whose messages are taken", actual
        )
        self._node.note(f"other publishers of {self._topic}", refusal)
        self._node.refuse(self._topic, refusal, dropped)

    def withhold_message(self, data: bytes, publisher: bytes) -> None:
        """Keep a message that was not admitted, where its publisher does not repeat it."""
        if self._keeps:
            self.withheld = [*self.withheld[1 - WITHHELD_LIMIT :], (data, publisher)]

    def release_withheld(self) -> list[bytes]:
        """Return messages that were withheld and whose publisher is the one by now."""
        if not self.withheld:
            return []
        nodes = self._list_nodes()
        for publisher in {publisher for _, publisher in self.withheld}:
            if publisher != self._owner and self._judge_publisher(publisher, nodes)[0]:
                self._take_over(publisher)
        released = [data for data, publisher in self.withheld if publisher == self._owner]
        self.withheld = [
            message
            for message in self.withheld
            if message[1] != self._owner and message[1] in nodes
        ]
        return released

    def _take_over(self, publisher: bytes) -> None:
        self._owner = publisher
        self._judged_until.clear()
        self.owner.id, self.owner.quiet_until = publisher, 0

    def _list_nodes(self) -> dict[bytes, str]:
        """Return the full name of the node of each publisher of the topic."""
        endpoints = self._node.get_publishers_info_by_topic(self._full)
        return {bytes(endpoint.endpoint_gid): get_full_name(endpoint) for endpoint in endpoints}

    def _judge_publisher(self, publisher: bytes, nodes: dict[bytes, str]) -> tuple[bool, bool]:
        """Return whether a publisher is the one, and whether it stays so while it publishes."""
        of_kind = self._list_nodes_of_kind()
        ours = [gid for gid, name in nodes.items() if name in of_kind]
        has_lost, kind = self._node.has_lost, self._kind
        if publisher in ours:
            is_owner = publisher == self._owner or self._owner not in ours
            # The graph has a killed node for some time.
            return is_owner or has_lost(kind, len(ours)), is_owner
        if ours and not has_lost(kind, 1):
            return False, False
        return publisher == self._owner or self._owner not in nodes or self._owner in ours, False

    def _list_nodes_of_kind(self) -> set[str]:
        endpoints = self._node.get_publishers_info_by_topic
        return set.intersection(
            *({get_full_name(endpoint) for endpoint in endpoints(sign)} for sign in self._signs)
        )

    def _find_first_of_kind(self, nodes: dict[bytes, str]) -> str:
        """Return the first node of the kind among the publishers; empty: there is not one."""
        of_kind = self._list_nodes_of_kind()
        return next((name for name in nodes.values() if name in of_kind), "")


def call_back(subscription: Any, sole: SolePublisher | None, data: bytes, publisher: bytes) -> None:
    """Call back with the bytes of a message if its publisher is admitted."""
    if sole is None or sole.is_admitted(publisher):
        deliver_message(subscription, data)
    else:
        sole.withhold_message(data, publisher)


def deliver_message(subscription: Any, data: bytes) -> None:
    """Call back with the bytes of a message."""
    if subscription.raw:
        subscription.callback(data)
        return
    try:
        message = deserialize_message(data, subscription.msg_type)
    except (RuntimeError, ValueError):
        return  # not of this type: rcl drops it, too
    subscription.callback(message)


def get_full_name(endpoint: Any) -> str:
    """Return the full name of the node of a publisher or subscription."""
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def has_name(name: str) -> bool:
    """Return whether the graph had the name of a node: it may find a publisher before its node."""
    return name != "" and "UNKNOWN" not in name
