"""Messages between the other nodes, which the emulator's own record has for replays into them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from functools import partial

from rclpy.node import Node
from rclpy.subscription import Subscription

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.entities import take_message
from arm_emulator.ros.message_types import message_class
from arm_emulator.ros.node_shell import COMMAND_QOS
from arm_emulator.ros.node_topics import OF_OTHERS, TYPES


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
            kind = message_class(TYPES[name])
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
