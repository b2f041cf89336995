"""What a recorder knows of its own completeness: numbers of messages, ticks of motor states."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

from arm_emulator.recorder_presence import STATES
from arm_emulator_msgs.msg import MotorState, RecorderReport

REPORT_EVERY = 20  # motor states; an emulator in lock-step runs at most some times that ahead
GOOD_BYE = Duration(seconds=0.5)  # wall: for it to arrive
ASK_AGAIN = 5.0  # s, wall: after which a reset that has not come is asked for once more


class Numbered:
    """Counts what is lost on one topic, by the numbers that publishers give to their messages.

    Which publisher a number comes from is not told, so each message continues the publisher that it
    fits best.

    Args:
        publishers: tells how many there are.
    """

    def __init__(self, publishers: Callable[[], int]) -> None:
        self._publishers = publishers
        self._newest: list[int] = []  # of each publisher
        self._gaps = 0
        self._told_lost = 0

    @property
    def newest(self) -> int:
        """Number of the newest message of the publisher that has said most, 0 without any."""
        return max(self._newest, default=0)

    @property
    def lost(self) -> int:
        """Messages between others that did not come."""
        return max(self._gaps, self._told_lost)

    def on_lost(self, event: Any) -> None:
        """Take the middleware's word for what it lost."""
        self._told_lost = int(event.total_count)

    def take(self, number: int | None) -> None:
        """Count a message; None where the middleware gives no numbers."""
        if number is None:
            return
        newest = self._newest
        if number - 1 in newest:
            newest[newest.index(number - 1)] = number
            return
        before = max((one for one in newest if one < number), default=None)
        if before is None or self._publishers() > len(newest):
            newest.append(number)
            return
        self._gaps += number - before - 1
        newest[newest.index(before)] = number


class RecordedRuns:
    """Follows one emulator's ticks, and tells it how far they are written.

    Args:
        node: of the recorder.
        topic: the emulator's motor states.
        numbered: of the same topic.
        recorder: a name that no other recorder has.
        from_start: reset the machine if it runs already.

    Attributes:
        topic: as given.
        missing: ticks between others that did not come, and first ticks of later runs.
    """

    def __init__(
        self, node: Node, topic: str, numbered: Numbered, recorder: str, from_start: bool
    ) -> None:
        self.topic = topic
        self.missing = 0
        self._numbered = numbered
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
        """Follow a motor state that is written."""
        tick, before = int(deserialize_message(data, MotorState).tick), self._tick
        self._tick = tick
        if before < 0:
            self._on_first(tick)
        elif tick < before:
            self.missing += tick  # a new run
        else:
            self.missing += max(0, tick - before - 1)
        if tick == 0:
            self._reset = None
        self._unreported += 1
        if tick == 0 or self._unreported >= REPORT_EVERY:
            self.report()

    def report(self) -> None:
        """Tell the emulator what is written, and that somebody is here to write."""
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
        """Tell the emulator not to wait any more."""
        self._message.leaving = True
        self._reports.publish(self._message)
        self._reports.wait_for_all_acked(GOOD_BYE)

    def _on_first(self, tick: int) -> None:
        if tick > 0:
            what = (
                "it is reset now" if self._reset is not None
                else f"call {self._emulator}/reset, or record with --from-start"
            )  # fmt: skip
            print(
                f"{self.topic}: the machine is at tick {tick} already, and `check` needs a run "
                f"from tick 0 on: {what}",
                flush=True,
            )

    def _ask_for_reset(self, client: Any) -> None:
        if time.monotonic() > self._ask_at and client.service_is_ready():
            self._ask_at = time.monotonic() + ASK_AGAIN
            client.call_async(Trigger.Request())
