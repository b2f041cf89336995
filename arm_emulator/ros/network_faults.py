"""Faults of a running network: several clocks, and QoS that keep nodes from hearing each other."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible

CLOCK = "rosgraph_msgs/msg/Clock"


class NetworkFault(NamedTuple):
    """A fault, in words.

    Attributes:
        grave: whether no node may go on so.
        text: the fault.
        remedy: remedy.
    """

    grave: bool
    text: str
    remedy: str


def network_faults(node: Node) -> Iterator[NetworkFault]:
    """Yield the faults among all that a node has discovered."""
    for topic, kinds in node.get_topic_names_and_types():
        offers = node.get_publishers_info_by_topic(topic)
        if CLOCK in kinds and len(offers) > 1:
            names = ", ".join(sorted(map(_name, offers)))
            remedy = "end all but one, or give each network a ROS_DOMAIN_ID or namespace"
            yield NetworkFault(True, f"{topic} has {len(offers)} publishers: {names}", remedy)
        for wish in node.get_subscriptions_info_by_topic(topic):
            for offer in offers:
                level, reason = qos_check_compatible(offer.qos_profile, wish.qos_profile)
                if level == QoSCompatibility.ERROR:
                    why = str(reason).removeprefix("ERROR: ").strip(" ;")
                    text = f"{topic}: {_name(wish)} hears nothing of {_name(offer)}: {why}"
                    yield NetworkFault(False, text, "change the QoS of one of them")


def _name(endpoint: Any) -> str:
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
