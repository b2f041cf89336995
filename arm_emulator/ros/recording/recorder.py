"""Recorder: writes topics of the network, all or selected ones, into a bag, and counts losses."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from arm_emulator.base.process import list_end_signals
from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.messages.message_types import get_message_class, read_definition
from arm_emulator.ros.messages.middleware import get_middleware
from arm_emulator.ros.node.lean_executor import LeanExecutor
from arm_emulator.ros.node.sole_publisher import OwnExecutorOnly, receive_message, split_received
from arm_emulator.ros.recording.bag_metadata import Topic
from arm_emulator.ros.recording.bag_writer import BagWriter
from arm_emulator.ros.recording.recorder_presence import NAME, STATES, RecorderPresence
from arm_emulator.toolchain.c_header import CData
from arm_emulator.workarounds.exit_watchdog import start_exit_watchdog
from arm_emulator.workarounds.fastdds_shared_memory import clear_left_over
from arm_emulator_msgs.msg import MotorState, RecorderReport

LOOK_PERIOD = 0.1  # s, wall: interval of the search for new topics
FLUSH_PERIOD = 0.5  # s, wall: largest loss in a crash
ENDING = 5.0  # s, wall: time for the middleware to end
REPORT_PERIOD = 0.05  # s, wall: interval of reports to the emulators
DEPTH = 10_000  # messages: some seconds of every topic, should the disk be busy


class _Ended(Exception):
    """A signal has asked the recorder to end."""


@dataclass(frozen=True)
class Recorded:
    """Messages that a recorder has written, of these topics, in some time [s], and its losses.

    If it has ended by a failure, `refused` is the reason.
    """

    messages: int
    topics: tuple[str, ...]
    seconds: float
    lost: str
    refused: Refusal | None


def record_topics(
    out: Path,
    topics: Collection[str] | None,
    from_start: bool,
    presence: RecorderPresence,
    report: Callable[[Recorded], None],
) -> int:
    """Record until Ctrl-C; exit code 1 if something is missing.

    Args:
        out: folder of the new bag.
        topics: names, with or without the leading ``/``; None: all.
        from_start: reset a running machine, so that the bag has the run from tick 0 on.
        presence: announces this recorder to emulators on this machine.
        report: called when all is written; the process may end any time after it.

    Raises:
        Refusal: the folder exists, or the disk takes no more.
    """
    reported = threading.Event()  # to end
    # Not rclpy's handlers: they end publishing, and emulators wait for a recorder until it reports
    # its end. A signal interrupts nothing here: it is noticed between two messages.
    for number in list_end_signals():
        signal.signal(number, lambda *_: reported.set())
    node: _Recorder | None = None
    bag = BagWriter(out)
    failure: Exception | None = None
    try:
        with bag:
            clear_left_over()
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
            node = _Recorder(bag, topics, presence.recorder, from_start, reported)
            with contextlib.suppress(_Ended):
                LeanExecutor(node, take=node.take_message).spin()
            node.take_the_rest()
    except (OSError, MemoryError) as error:
        failure = error
    finally:
        if node is not None:
            node.report_end()
    written = tuple(topic.name for topic in bag.topics if topic.count)
    count = sum(topic.count for topic in bag.topics)
    lost = "" if node is None else node.lost
    refused: Refusal | None = None
    if failure is not None:
        cure = None if bag.is_complete else f"make room, then `arm_emulator repair {out}`"
        refused = Refusal("record", f"folder {out}", "accept the recorded messages", failure, cure)
    report(Recorded(count, written, bag.seconds, lost, refused))
    code = 2 if failure is not None else 1 if lost else 0
    with start_exit_watchdog(ENDING, code):
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    if refused is not None:
        raise refused
    return code


class _Recorder(Node):
    """Subscribes to topics as they appear and writes their messages as raw bytes."""

    def __init__(
        self,
        bag: BagWriter,
        topics: Collection[str] | None,
        name: str,
        from_start: bool,
        end_requested: threading.Event,
    ) -> None:
        super().__init__(NAME, enable_rosout=False, start_parameter_services=False)
        self._bag = bag
        self._name = name
        self._from_start = from_start
        self._end_requested = end_requested
        self._selected = None if topics is None else {self.resolve_topic_name(t) for t in topics}
        self._visited_topics: set[str] = set()
        self._numbered: dict[str, Numbered] = {}  # by topic
        self._writers: dict[Any, Callable[[CData], None]] = {}  # by subscription
        get_middleware()  # before the first message
        self._runs: list[RecordedRuns] = []
        self._reported_lost = ""
        self.create_timer(LOOK_PERIOD, self._find_topics)
        self.create_timer(FLUSH_PERIOD, bag.flush)
        self.create_timer(REPORT_PERIOD, self._report_ticks)
        self._find_topics()

    @property
    def lost(self) -> str:
        """Missing messages, as text; empty if complete."""
        missing = {run.topic: f"{run.missing} ticks" for run in self._runs if run.missing}
        for name, numbered in self._numbered.items():
            if numbered.lost and name not in missing:
                missing[name] = f"{numbered.lost} messages"
        return ", ".join(f"{count} of {name}" for name, count in sorted(missing.items()))

    def _forget_losses(self) -> None:
        """Count losses from the run on that was asked for: a machine does not wait before it."""
        for numbered in self._numbered.values():
            numbered.restart_count()

    def take_the_rest(self) -> None:
        """Write the messages that have arrived: of one topic they may be older than of another."""
        for subscription in [*self.subscriptions]:
            for _ in range(DEPTH):
                if not self.take_message(subscription):
                    break

    def take_message(self, subscription: Any, _: object = None) -> bool:
        """Write the oldest message of a subscription; return whether there was one."""
        message = receive_message(subscription)
        if message is not None:
            self._writers[subscription](message)
        return message is not None

    def report_end(self) -> None:
        """Report to the emulators that they need not wait for this recorder any more."""
        for run in self._runs:
            run.report_end()

    def _report_ticks(self) -> None:
        if self._end_requested.is_set():
            raise _Ended
        for run in self._runs:
            run.report_ticks()
        if self.lost != self._reported_lost:
            self._reported_lost = self.lost
            print(f"lost so far: {self.lost}", flush=True)

    def _find_topics(self) -> None:
        for name, types in self.get_topic_names_and_types():
            hidden = any(part.startswith("_") for part in name.split("/"))
            if name in self._visited_topics or (
                hidden if self._selected is None else name not in self._selected
            ):
                continue
            publishers = [
                endpoint
                for endpoint in self.get_publishers_info_by_topic(name)
                if endpoint.topic_type == types[0]
            ]
            others = [
                publisher for publisher in publishers if publisher.node_name != self.get_name()
            ]
            if others:
                self._visited_topics.add(name)
                self._subscribe_to(name, types[0], others)

    def _subscribe_to(self, name: str, kind: str, publishers: list[Any]) -> None:
        try:
            message = get_message_class(kind)
        except Refusal as reason:
            print(f"{name} is not recorded: {reason}", flush=True)
            return
        offered = tuple(publisher.qos_profile for publisher in publishers)
        number = self._bag.add_topic(
            Topic(name, kind, read_definition(kind), offered, str(publishers[0].topic_type_hash))
        )
        numbered = Numbered()
        self._numbered[name] = numbered
        follow: Callable[[bytes], None] | None = None
        if name.endswith(f"/{STATES}") and message is MotorState:
            run = RecordedRuns(
                self, name, numbered, self._name, self._from_start, self._forget_losses
            )
            self._runs.append(run)
            follow = run.follow_state
        events = SubscriptionEventCallbacks(message_lost=numbered.take_lost_event)
        group = OwnExecutorOnly()  # rclpy drops the publisher of a message
        subscription = self.create_subscription(
            message, name, lambda _: None, choose_qos(offered), event_callbacks=events,
            callback_group=group,
        )  # fmt: skip
        self._writers[subscription] = self._make_writer(number, numbered, follow)
        print(f"recording {name}", flush=True)

    def _make_writer(
        self, topic: int, numbered: Numbered, follow: Callable[[bytes], None] | None
    ) -> Callable[[CData], None]:
        def write_message(message: CData) -> None:
            data, publisher = split_received(message)
            self._bag.write_message(topic, time.time_ns(), message.sent, data)
            numbered.count_message(publisher, message.number)
            if follow is not None:
                follow(data)

        return write_message


def choose_qos(offered: Collection[QoSProfile]) -> QoSProfile:
    """Return the strongest QoS that every publisher offers."""
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in offered)
    latched = all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in offered)
    return QoSProfile(
        depth=DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


REPORT_EVERY = 20  # motor states; an emulator in lock-step is at most a few times that many ahead
GOOD_BYE = Duration(seconds=0.5)  # wall: for it to arrive
ASK_AGAIN = 5.0  # s, wall: after which a missing reset is requested again


class Numbered:
    """Counts what is lost on one topic, by the numbers that publishers give to their messages."""

    def __init__(self) -> None:
        self._last: dict[bytes, int] = {}  # number of the newest message, by publisher
        self._gaps = 0
        self._reported = 0  # by the middleware
        self._forgotten = 0, 0  # of the gaps, and of what the middleware has reported

    @property
    def newest(self) -> int:
        """Number of the newest message of the publisher with the most messages, 0 without any."""
        return max(self._last.values(), default=0)

    @property
    def lost(self) -> int:
        """Missing messages between received ones."""
        return max(self._gaps - self._forgotten[0], self._reported - self._forgotten[1])

    def restart_count(self) -> None:
        """Count what is lost from now on; the middleware may report later what gaps have shown."""
        self._forgotten = self._gaps, max(self._gaps, self._reported)

    def take_lost_event(self, event: Any) -> None:
        """Count messages that the middleware reports as lost."""
        self._reported = int(event.total_count)

    def count_message(self, publisher: bytes, number: int) -> None:
        """Count a message of a publisher; number -1: the middleware gives none."""
        if number >= 0:
            self._gaps += max(0, number - self._last.get(publisher, number) - 1)
            self._last[publisher] = number


class RecordedRuns:
    """Follows one emulator's ticks, and reports to it the progress of writing.

    Args:
        node: of the recorder.
        topic: the emulator's motor states.
        numbered: of the same topic.
        recorder: unique name.
        from_start: reset a machine that is already running.
        begun: called when a run begins that was asked for.

    Attributes:
        topic: as given.
        missing: ticks missing between others, and first ticks of later runs.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        numbered: Numbered,
        recorder: str,
        from_start: bool,
        begun: Callable[[], None],
    ) -> None:
        self.topic = topic
        self.missing = 0
        self._numbered, self._begun = numbered, begun
        self._emulator = topic.removesuffix(STATES) + "emulator"
        self._message = RecorderReport(recorder=recorder)
        self._reports = node.create_publisher(
            RecorderReport, f"{self._emulator}/recorders", QoSProfile(depth=10)
        )
        self._reset = node.create_client(Trigger, f"{self._emulator}/reset") if from_start else None
        self._ask_at = 0.0  # wall time, when the reset may be asked for (again)
        self._tick = -1
        self._unreported = 0
        self._greeted = False

    def follow_state(self, data: bytes) -> None:
        """Follow a written motor state."""
        tick, before = int(deserialize_message(data, MotorState).tick), self._tick
        self._tick = tick
        if before < 0:
            self._report_first(tick)
        elif tick < before:
            self.missing += tick  # a new run
        else:
            self.missing += max(0, tick - before - 1)
        if tick == 0 and self._reset is not None:
            self._reset, self.missing = None, 0
            self._begun()
        self._unreported += 1
        if tick == 0 or self._unreported >= REPORT_EVERY:
            self.report_ticks()

    def report_ticks(self) -> None:
        """Report to the emulator the written ticks, and thereby the recorder's presence."""
        written = self._numbered.newest
        if self._reset is not None and self._tick > 0:
            self._ask_for_reset(self._reset)
        if self._greeted and written == self._message.written:
            return
        self._greeted = self._greeted or self._reports.get_subscription_count() > 0
        self._unreported = 0
        self._message.written = written
        self._reports.publish(self._message)

    def report_end(self) -> None:
        """Report to the emulator that it need not wait any longer."""
        self._message.leaving = True
        self._reports.publish(self._message)
        self._reports.wait_for_all_acked(GOOD_BYE)

    def _report_first(self, tick: int) -> None:
        print(f"{self.topic}: the first state has arrived, tick {tick}", flush=True)
        if tick > 0:
            cause = (
                "it is reset now" if self._reset is not None
                else f"call {self._emulator}/reset, or record with --from-start"
            )  # fmt: skip
            print(
                f"{self.topic}: the machine is at tick {tick} already, and `check-bag` needs a run "
                f"from tick 0 on: {cause}",
                flush=True,
            )

    def _ask_for_reset(self, client: Any) -> None:
        if time.monotonic() > self._ask_at and client.service_is_ready():
            self._ask_at = time.monotonic() + ASK_AGAIN
            client.call_async(Trigger.Request())
