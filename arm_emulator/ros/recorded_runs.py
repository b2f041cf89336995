"""Completeness of a recording, by the numbers of messages and the ticks of motor states."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

from arm_emulator.ros.recorder_presence import STATES
from arm_emulator_msgs.msg import MotorState, RecorderReport

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

    def forget(self) -> None:
        """Count what is lost from now on; the middleware may report later what gaps have shown."""
        self._forgotten = self._gaps, max(self._gaps, self._reported)

    def on_lost(self, event: Any) -> None:
        """Count messages that the middleware reports as lost."""
        self._reported = int(event.total_count)

    def take(self, publisher: bytes, number: int) -> None:
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

    def take(self, data: bytes) -> None:
        """Follow a written motor state."""
        tick, before = int(deserialize_message(data, MotorState).tick), self._tick
        self._tick = tick
        if before < 0:
            self._on_first(tick)
        elif tick < before:
            self.missing += tick  # a new run
        else:
            self.missing += max(0, tick - before - 1)
        if tick == 0 and self._reset is not None:
            self._reset, self.missing = None, 0
            self._begun()
        self._unreported += 1
        if tick == 0 or self._unreported >= REPORT_EVERY:
            self.report()

    def report(self) -> None:
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

    def leave(self) -> None:
        """Report to the emulator that it need not wait any longer."""
        self._message.leaving = True
        self._reports.publish(self._message)
        self._reports.wait_for_all_acked(GOOD_BYE)

    def _on_first(self, tick: int) -> None:
        print(f"{self.topic}: the first state has arrived, tick {tick}", flush=True)
        if tick > 0:
            what = (
                "it is reset now" if self._reset is not None
                else f"call {self._emulator}/reset, or record with --from-start"
            )  # fmt: skip
            print(
                f"{self.topic}: the machine is at tick {tick} already, and `check-bag` needs a run "
                f"from tick 0 on: {what}",
                flush=True,
            )

    def _ask_for_reset(self, client: Any) -> None:
        if time.monotonic() > self._ask_at and client.service_is_ready():
            self._ask_at = time.monotonic() + ASK_AGAIN
            client.call_async(Trigger.Request())
