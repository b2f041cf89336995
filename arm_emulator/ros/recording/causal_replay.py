"""A recorded network, played into one of its nodes: each message follows the answer to the last.

A replay by the clock loses messages that the node cannot take in time. A servo that waits for
targets never gets them at the right tick. Here the node under test decides how fast time passes, as
in lock-step: the same node gives the same bits in every replay.
"""

from __future__ import annotations

import bisect
import hashlib
import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.messages.message_types import get_message_class
from arm_emulator.ros.messages.node_topics import NODES, STATUS, TYPES
from arm_emulator.ros.node.network_client import NetworkClient
from arm_emulator.ros.node.node_shell import COMMAND_QOS, DESCRIPTION_QOS
from arm_emulator.ros.recording.bag import Bag
from arm_emulator.ros.recording.replay_messages import (
    AHEAD,
    STATES_OF_TAKEN_ORDERS,
    RecordedMessage,
    ReplayedOrder,
    StampedMessages,
    get_key,
    get_number_bytes,
    get_stamp,
)
from arm_emulator_msgs.msg import MotionStatus

DISCOVERY = 10.0  # s, wall: to find the node under test
RESEND = 0.2  # s, wall: a message without an answer is published again
PATIENCE = 5.0  # s, wall: with one answer
MISSING_LIMIT = 3  # answers, after which the others are not waited for
ACKNOWLEDGE = Duration(seconds=1)
HEARD_QOS = QoSProfile(depth=1000)


@dataclass
class ReplayResult:
    """Answers of a node to a bag.

    Attributes:
        requested: messages that needed an answer.
        answered: those that got one.
        missing: where the first ones did not, in words.
        alike: answers with the recorded numbers.
        find_first_difference: where the first answer had other numbers, in words; empty: nowhere.
        digest: of all answers' numbers.
    """

    requested: int = 0
    answered: int = 0
    missing: list[str] = field(default_factory=list)
    alike: int = 0
    first_difference: str = ""
    digest: str = ""


class CausalReplay:
    """Plays a bag into a node.

    Args:
        bag: with the topics of the node, of `record` or `up --record`.
        name: of the node: "servo" or "motion_controller".
        node: publishes.

    Raises:
        Refusal: the bag lacks a topic, or has goals that are not in it.
    """

    def __init__(self, bag: Bag, name: str, node: NetworkClient) -> None:
        self._bag, self._name, self._node, self._topics = bag, name, node, NODES[name]
        self._where = str(bag.path)
        ends = [topic for topic in bag.topics if topic.endswith("/joint_targets")]
        if len(ends) != 1:
            actual = ", ".join(ends or sorted(bag.topics)) or "no topics"
            valid = "bags of `record`, and of `up --record` of this version"
            raise Refusal(self._where, "the bag", "have one topic joint_targets", actual, valid)
        self._namespace = ends[0].removesuffix("joint_targets")
        for topic in filter(None, (self._topics.requests, self._topics.at_first)):
            if self._count_message(topic) == 0:
                raise Refusal(self._where, "the bag", f"have messages on {topic}", "none")
        self._result = ReplayResult()
        self._run = -1
        self._digest = hashlib.sha256()
        self._received: list[Any] = []
        self._prompts: set[int] = set()
        self._statuses: list[MotionStatus] = []
        self._publishers: dict[str, Publisher] = {}
        self._orders = deque(self._place_orders())

    def play_bag(self, wait: bool, report: Callable[[str], None]) -> ReplayResult:
        """Play the bag.

        Args:
            wait: for as long as it takes until the node is there.
            report: gets a line about what is waited for.

        Raises:
            Refusal: no such node is in the network, or another node publishes what is replayed.
        """
        topics, result = self._topics, self._result
        self._connect_topics(wait, report)
        begin = next(self._read_recorded(topics.requests)).published
        recorded = self._index_by_stamp(topics.answered, attrgetter("key"), begin)
        granted = self._index_by_stamp(topics.granted, attrgetter("stamp"), begin)
        beside = self._index_by_stamp(topics.beside, attrgetter("stamp"), begin)
        before: int | None = None
        end = math.inf  # stamp [ns] from which on the node waits for what the bag does not have
        for request in self._read_recorded(topics.requests):
            key, stamp = request.key, request.stamp
            if key == before:
                continue  # it was published again
            if before is None or key < before:
                self._begin_run()
                end = math.inf
            before = key
            expected = recorded.take_message(key)
            if topics.beside and (data := beside.take_message(stamp)) is not None:
                self._publishers[topics.beside].publish(data)
            # No motion period begins here, or the recorder ended before the answer.
            if expected is None and (recorded.is_over if topics.granted else True):
                self._publishers[topics.requests].publish(request.data)
                continue
            if end <= stamp < end + granted.period:
                continue
            result.requested += 1
            if len(result.missing) < MISSING_LIMIT:
                grant = granted.take_message(stamp)
                # The recorder may end before the last message for which the node waits.
                ends = grant is None and granted.is_over
                answer = self._ask_node(request, grant, ends)
                if answer is None and ends and stamp in self._prompts:
                    end = stamp
                    result.requested -= 1
                else:
                    self._compare_answer(request, answer, expected)
            self._give_orders(stamp, request.published)
        result.digest = self._digest.hexdigest()[:16]
        return result

    # Bag

    def _get_full_name(self, topic: str) -> str:
        return self._namespace + topic

    def _count_message(self, topic: str) -> int:
        topic_info = self._bag.topics.get(self._get_full_name(topic))
        return 0 if topic_info is None else topic_info.count

    def _read_recorded(self, topic: str) -> Iterator[RecordedMessage]:
        kind = get_message_class(TYPES[topic])
        for record in self._bag.read_as_published([self._get_full_name(topic)]):
            try:
                message = deserialize_message(record.data, kind)
            except RuntimeError as error:
                rule = "be readable"
                raise Refusal(self._where, f"messages on {topic}", rule, error) from None
            yield RecordedMessage(message, record)

    def _index_by_stamp(
        self, topic: str, key: Callable[[RecordedMessage], int], begin: int
    ) -> StampedMessages:
        """Return the messages of a topic from the first question on, by their keys.

        A recorder may find the node that answers seconds before the one that asks.

        Args:
            topic: empty: no messages.
            key: of a message.
            begin: when the first question was published, wall time [ns].
        """
        messages = list(self._read_recorded(topic)) if topic else []
        earlier = bisect.bisect_left(messages, begin, key=lambda message: message.published)
        # Some of them, since the clocks of two computers differ.
        messages = messages[max(0, earlier - AHEAD // 2) :]
        return StampedMessages([(key(message), message.data) for message in messages])

    def _place_orders(self) -> list[ReplayedOrder]:
        """Return the orders, with the stamp of the joint states after which each was taken.

        Raises:
            Refusal: goals of the action, which bags do not hold.
        """
        if not self._topics.orders:
            return []
        starts: list[int] = []  # of the runs, wall time [ns]
        before = math.inf
        for request in self._read_recorded(self._topics.requests):
            if request.key < before:
                starts.append(request.published)
            before = request.key

        def run_of(message: RecordedMessage) -> int:
            return max(0, bisect.bisect_right(starts, message.published) - 1)

        taken: dict[int, deque[tuple[int, int, bool]]] = {k: deque() for k in self._topics.orders}
        statuses = list(self._read_recorded(STATUS))
        at_first = {
            (status.message.kind, status.message.number)
            for status in statuses
            if status.message.state == MotionStatus.STATE_MOVING and status.stamp == 0
        }
        for status in statuses:
            kind, number = status.message.kind, status.message.number
            if kind in taken and status.message.state in STATES_OF_TAKEN_ORDERS:
                taken[kind].append((run_of(status), status.stamp, (kind, number) in at_first))
        orders = []
        for kind, topic in self._topics.orders.items():
            places = taken[kind]
            if len(places) > self._count_message(topic):
                rule = f"have the {len(places)} orders that motion/status reports"
                actual = (
                    f"{self._count_message(topic)}, the others were goals of an action or are lost"
                )
                raise Refusal(self._where, topic, rule, actual)
            for order in self._read_recorded(topic):
                run, after, first = places.popleft() if places else (run_of(order), None, False)
                orders.append(
                    ReplayedOrder(topic, order.data, order.published, run, after, first, kind)
                )
        for topic in self._topics.jogs:
            if self._count_message(topic):
                orders += [
                    ReplayedOrder(topic, m.data, m.published, run_of(m), None, False, 0)
                    for m in self._read_recorded(topic)
                ]
        return sorted(orders, key=lambda order: order.published)

    # Network

    def _connect_topics(self, wait: bool, report: Callable[[str], None]) -> None:
        node, topics = self._node, self._topics
        for topic in topics.inputs:
            if self._count_message(topic):
                qos = DESCRIPTION_QOS if topic == topics.at_first else COMMAND_QOS
                kind = get_message_class(TYPES[topic])
                self._publishers[topic] = node.create_publisher(
                    kind, self._get_full_name(topic), qos
                )
        self._subscribe_to(topics.answered, self._received.append)
        if topics.prompt:
            self._subscribe_to(topics.prompt, lambda message: self._prompts.add(get_stamp(message)))
        if topics.orders:
            self._subscribe_to(STATUS, self._statuses.append)
        needed = [self._publishers[topic] for topic in (topics.requests, topics.granted) if topic]
        answered = self._get_full_name(topics.answered)

        def is_ready() -> bool:
            there = all(publisher.get_subscription_count() for publisher in needed)
            return there and node.count_publishers(answered) > 0

        reported = False
        while not node.spin_until(is_ready, DISCOVERY):
            if not wait:
                rule = f"be taken by a {self._name}, which publishes {answered}"
                valid = "start it in the same ROS_DOMAIN_ID, without an emulator"
                actual = f"none in {DISCOVERY:g} s"
                raise Refusal("replay", self._get_full_name(topics.requests), rule, actual, valid)
            if not reported:
                report(f"waiting for a {self._name}")
                reported = True
        self._needed = [publisher.topic_name for publisher in needed]
        self._refuse_other_publishers()

    def _refuse_other_publishers(self) -> None:
        """Refuse publishers beside the replay, which the network may find late.

        Raises:
            Refusal: there are some.
        """
        for topic in self._needed:
            others = self._node.count_publishers(topic) - 1
            if others > 0:
                rule = "be published by the replay alone"
                raise Refusal("replay", topic, rule, f"{others} more publishers")

    def _subscribe_to(self, topic: str, take: Callable[[Any], Any]) -> None:
        kind = get_message_class(TYPES[topic])
        self._node.create_subscription(kind, self._get_full_name(topic), take, HEARD_QOS)

    def _begin_run(self) -> None:
        """Let the node start over, and give it what it needs first."""
        reset = self._node.create_client(Trigger, self._get_full_name(f"{self._name}/reset"))
        if self._node.spin_until(reset.service_is_ready, RESEND):
            self._node.call_service(reset, Trigger.Request(), PATIENCE)
        self._node.destroy_client(reset)
        self._prompts.clear()
        if self._topics.at_first:
            first = next(self._read_recorded(self._topics.at_first))
            self._publishers[self._topics.at_first].publish(first.data)
        self._run += 1
        while self._orders and self._orders[0].first and self._orders[0].run == self._run:
            self._give_order(self._orders.popleft())

    def _ask_node(self, request: RecordedMessage, granted: bytes | None, ends: bool) -> Any:
        """Publish a message; return the answer to it, or None after some time.

        Args:
            request: the message.
            granted: what the node waits for before it answers, or None.
            ends: the bag has nothing more that the node could wait for, so None is returned as soon
                as it waits.
        """
        topics, key, stamp = self._topics, request.key, request.stamp
        publisher, granted_once, again = self._publishers[topics.requests], False, False
        self._received.clear()

        def is_answered() -> bool:
            nonlocal granted_once
            # A servo of another kind may not report that it waits.
            if granted is not None and not granted_once and (stamp in self._prompts or again):
                self._publishers[topics.granted].publish(granted)
                granted_once = True
            while self._received:
                if get_key(self._received[0]) == key:
                    return True
                self._received.pop(0)
            return False

        for _ in range(round(PATIENCE / RESEND)):
            publisher.publish(request.data)
            if self._node.spin_until(is_answered, RESEND):
                self._prompts.clear()
                return self._received.pop(0)
            if ends and stamp in self._prompts:
                break
            granted_once, again = False, True
        return None

    def _compare_answer(
        self, request: RecordedMessage, answer: Any, expected: bytes | None
    ) -> None:
        result, where = self._result, f"t = {request.stamp * 1e-9:g} s"
        if answer is None:
            self._refuse_other_publishers()
            result.missing.append(where)
            return
        result.answered += 1
        numbers = get_number_bytes(answer)
        self._digest.update(request.key.to_bytes(8, "little") + numbers)
        if expected is None:
            return
        kind = get_message_class(TYPES[self._topics.answered])
        if numbers == get_number_bytes(deserialize_message(expected, kind)):
            result.alike += 1
        else:
            result.first_difference = result.first_difference or where

    def _give_orders(self, stamp: int, published: int) -> None:
        """Give the orders that came after this message."""
        while self._orders:
            order = self._orders[0]
            comes = order.published <= published if order.after is None else order.after <= stamp
            if order.run > self._run or not (comes or order.run < self._run):
                return
            self._give_order(self._orders.popleft())

    def _give_order(self, order: ReplayedOrder) -> None:
        """Publish an order, and wait until the node has taken it."""
        publisher = self._publishers[order.topic]
        self._node.spin_until(lambda: publisher.get_subscription_count() > 0, PATIENCE)
        self._statuses.clear()
        publisher.publish(order.data)
        publisher.wait_for_all_acked(ACKNOWLEDGE)
        if not order.kind:
            return

        def is_taken() -> bool:
            return any(
                status.kind == order.kind and status.state in STATES_OF_TAKEN_ORDERS
                for status in self._statuses
            )

        self._node.spin_until(is_taken, PATIENCE)
