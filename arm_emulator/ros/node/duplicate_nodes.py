"""A second node of one kind on the same topics: reported by both, with node, host and process.

Every node publishes in its diagnostics its kind, its topic, its host and its start time. The node
that was started first serves, and all nodes know which one that is.
"""

import os
import socket
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.node.barrier import Restart
from arm_emulator.ros.node.managed_node import ManagedNode
from arm_emulator.ros.node.node_shell import Diagnostics, create_wall_timer
from arm_emulator.ros.node.sole_publisher import IDENTIFY, KINDS, get_full_name

LISTEN = 0.5  # s, wall: for the middleware to find running nodes
SILENCE = 5.0  # s, wall: a node that is silent for so long is gone
KILLED_AFTER = (
    3.0  # s, wall: below `SILENCE`, so that a node that waited for it is admitted without delay
)
HEARD_LIMIT = 100  # nodes of a kind: anyone can publish diagnostics
FORGOTTEN = 30.0  # s, wall: the graph does not have a killed node for so long
LOOK_PERIOD = 0.25  # s, wall


def get_start_time() -> int:
    """Return the wall time [ns] of this process's start, which identifies it."""
    return _get_start_time_of(os.getpid())


@cache
def _get_start_time_of(process: int) -> int:
    """Return the time of the first call in a process: one that was forked has a time of its own."""
    return time.time_ns()


@dataclass(frozen=True)
class Identity:
    """Identity of one of our nodes, from its health.

    Attributes:
        kind: of `KINDS`.
        topic: full name of its first topic.
        started: its start time, decimal [ns].
        words: node, host and process.
    """

    kind: str
    topic: str
    started: str
    words: str


def read_identities(array: DiagnosticArray) -> Iterator[tuple[str, Identity]]:
    """Yield full name and identity of each of our nodes whose health is in a message."""
    for status in array.status:
        values = {pair.key: pair.value for pair in status.values}
        kind, started = values.get("kind", ""), values.get("started [ns]", "")
        if kind in KINDS and started.isdecimal():
            words = (
                f"node /{status.name} on host {values.get('host', 'unknown')}, "
                f"process {values.get('process', 'unknown')}"
            )
            yield f"/{status.name}", Identity(kind, values.get("topic", ""), started, words)


@dataclass
class _Duplicate:
    node: str  # its full name
    words: str
    heard_at: float  # s, monotonic
    is_listed: bool = False  # by the middleware, which may learn of it a little later


class DuplicateNodes:
    """Finds other nodes of this one's kind that publish on the same topic.

    Args:
        node: this node.
        diagnostics: diagnostics that name the others.
        kind: such as "emulator".
        topic: the topic that only one of them should publish on.
        consequence: consequence of two of them, as text.
    """

    def __init__(
        self, node: Node, diagnostics: Diagnostics, kind: str, topic: str, consequence: str
    ) -> None:
        self._node, self._diagnostics = node, diagnostics
        self._kind, self._topic = kind, node.resolve_topic_name(topic)
        self._consequence = consequence
        self._duplicates: dict[int, _Duplicate] = {}  # by start time
        self._created_at = time.monotonic()  # the middleware has looked for others since then
        self._leads = self._works = False
        self._started = get_start_time()
        self._mine = {
            "kind": kind,
            "topic": self._topic,
            "host": socket.gethostname(),
            "process": os.getpid(),
            "started [ns]": self._started,
        }
        late = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        # Time at which a node of each kind was heard last, by its start time.
        self._heard: dict[str, dict[str, float]] = {kind: {} for kind in KINDS}
        self._signs = {kind: node.resolve_topic_name(signs[0]) for kind, signs in KINDS.items()}
        if isinstance(node, ManagedNode):
            node.has_lost = self._has_lost
        node.create_subscription(DiagnosticArray, "diagnostics", self._take_diagnostics, late)
        create_wall_timer(node, LOOK_PERIOD, self._remove_ended_nodes)

    def announce_node(self) -> None:
        """Identify this node as one that works."""
        self._works = True
        self._diagnostics.values.update(self._mine)
        for started, duplicate in self._duplicates.items():
            self._report_duplicate(started, duplicate.words)

    def withdraw_node(self) -> None:
        """Count this node as idle: no double of any other."""
        self._works = self._leads = False
        for name in self._mine:
            self._diagnostics.values.pop(name, None)
        self._publish_duplicates()

    def wait_until_first(self, sign: str, *, alone: bool = False) -> None:
        """Serve the node, silent but for its diagnostics, until no earlier one is present.

        Afterwards `Restart` is raised if an earlier node is found after all. The middleware may
        find it late on a busy machine.

        Args:
            sign: a topic on which only nodes of this kind publish.
            alone: refuse to wait.

        Raises:
            Refusal: an earlier one is present, and this one was to be alone.
        """
        executor = SingleThreadedExecutor(context=self._node.context)
        executor.add_node(self._node)
        full = self._node.resolve_topic_name(sign)
        own = sum(publisher.topic_name == full for publisher in self._node.publishers)

        def is_waiting() -> bool:
            listened = time.monotonic() - self._created_at
            if listened < LISTEN or self._find_first():
                return True
            unknown = self._node.count_publishers(sign) - own > len(self._duplicates)
            return unknown and listened < IDENTIFY

        executor.spin_once(timeout_sec=0.0)
        while is_waiting():
            executor.spin_once(timeout_sec=0.05)
            first = self._find_first()
            if first and alone:
                executor.remove_node(self._node)
                self.withdraw_node()
                rule = f"be the only one on {self._topic}"
                actual = f"another one that was started before, {first.words}"
                valid = "--allow-second, or allow_second:=true in the launch file"
                raise Refusal(
                    f"node {self._node.get_name()}", f"the {self._kind}", rule, actual, valid
                )
            if first:
                self._diagnostics.report_warning(
                    f"silent until it ends: another {self._kind} was started before on "
                    f"{self._topic}, {first.words}"
                )
        executor.remove_node(self._node)
        executor.shutdown()
        self._leads = True

    def _find_first(self) -> _Duplicate | None:
        """Return the one that was started first, None if that is this node."""
        first = min(self._duplicates, default=self._started)
        return self._duplicates[first] if first < self._started else None

    def _take_diagnostics(self, array: DiagnosticArray) -> None:
        for name, identity in read_identities(array):
            if identity.topic != self._signs[identity.kind]:
                continue
            self._record_sign_of_life(identity.kind, identity.started)
            started = int(identity.started)
            if identity.kind != self._kind or started == self._started:
                continue
            duplicate = self._duplicates.get(started)
            if duplicate is not None:
                duplicate.heard_at = time.monotonic()
                continue
            self._duplicates[started] = _Duplicate(name, identity.words, time.monotonic())
            self._report_duplicate(started, identity.words)

    def _record_sign_of_life(self, kind: str, started: str) -> None:
        heard, now = self._heard[kind], time.monotonic()
        heard[started] = now
        if len(heard) > HEARD_LIMIT:
            self._heard[kind] = {
                begun: at for begun, at in heard.items() if now - at < KILLED_AFTER
            }

    def _has_lost(self, kind: str, there: int) -> bool:
        """Return whether of so many publishers of a kind of nodes one was killed.

        The graph has a killed node for some time. The nodes that run report their health.
        """
        heard, now = self._heard[kind], time.monotonic()
        silences = [now - at for at in heard.values()]
        alive = sum(silence < KILLED_AFTER for silence in silences)
        return alive < there and any(KILLED_AFTER <= silence < FORGOTTEN for silence in silences)

    def _report_duplicate(self, started: int, words: str) -> None:
        if not self._works:
            return
        if self._leads and started < self._started:
            raise Restart
        order = "before" if started < self._started else "after"
        self._node.get_logger().warning(
            f"another {self._kind} is on {self._topic}, started {order} this one: {words}; "
            f"{self._consequence}"
        )
        self._publish_duplicates()

    def _publish_duplicates(self) -> None:
        self._diagnostics.duplicates = (
            {f"another {self._kind}": "; ".join(value.words for value in self._duplicates.values())}
            if self._duplicates and self._works
            else {}
        )
        self._diagnostics.publish_now()

    def _remove_ended_nodes(self) -> None:
        if not self._duplicates:
            return
        now, node = time.monotonic(), self._node
        there = [
            get_full_name(endpoint)
            for endpoint in node.get_publishers_info_by_topic(
                node.resolve_topic_name("diagnostics")
            )
        ]
        mine = node.get_fully_qualified_name()
        if mine in there:
            there.remove(mine)
        for started, duplicate in list(self._duplicates.items()):
            left = duplicate.is_listed and duplicate.node not in there
            duplicate.is_listed = duplicate.node in there
            if left or now - duplicate.heard_at > SILENCE:
                del self._duplicates[started]
                node.get_logger().info(f"the other {self._kind} is gone: {duplicate.words}")
                self._publish_duplicates()
