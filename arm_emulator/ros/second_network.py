"""A network that is to be started beside one that runs on the same topics."""

from __future__ import annotations

import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.doubles import identities_of
from arm_emulator.ros.network_guest import guest
from arm_emulator.ros.sole_publisher import IDENTIFY, KINDS

LISTEN = 1.5  # s, wall: for the middleware of a busy machine to find running nodes


def refuse_second_network(namespace: str, option: str) -> None:
    """Listen whether nodes of ours run on the topics of a namespace.

    Two networks that start at the same moment do not find each other here: the younger emulator
    does, see the parameter `alone` of its node.

    Args:
        namespace: of the network that is to be started.
        option: option by which a user allows it, as text.

    Raises:
        Refusal: there are some; it names them.
    """
    found: dict[str, str] = {}  # nodes by their start times
    late = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    with guest("up", namespace) as node:
        signs = {kind: node.resolve_topic_name(topics[0]) for kind, topics in KINDS.items()}

        def take(array: DiagnosticArray) -> None:
            for _, one in identities_of(array):
                if one.topic == signs[one.kind]:
                    found[one.started] = one.words

        node.create_subscription(DiagnosticArray, "diagnostics", take, late)
        begin = time.monotonic()

        def has_listened() -> bool:
            there = sum(node.count_publishers(sign) for sign in signs.values())
            wait = IDENTIFY if there > len(found) else LISTEN
            return time.monotonic() - begin >= wait

        node.spin_until(has_listened, IDENTIFY)
    if found:
        first = min(found, key=int)
        rule = f"be the only one on its topics, without {option}"
        others = f" and {len(found) - 1} more" if len(found) > 1 else ""
        raise Refusal("second network", "a network", rule, f"{found[first]}{others}")
