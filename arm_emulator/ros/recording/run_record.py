"""The emulator's own record: a bag of its outputs and inputs, independent of the network.

In lock-step the machine waits for a slow disk; in real time it does not wait, and messages that do
not fit into the queue are counted.
"""

import atexit
import threading
import time
from collections import deque
from pathlib import Path

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.recording.bag_metadata import Topic
from arm_emulator.ros.recording.bag_writer import BagWriter

CAPACITY = 10_000  # messages between the machine and the disk: some seconds
SMALL = 10  # messages written at a time at least, some 0.1 ms of Python's lock
PART = (
    0.01  # share of the queue written at a time: the longer it is, the less the machine is spared
)
BREATH = 1e-4  # s, after each small step: lets the machine have Python's lock
IDLE = 0.02  # s, wall: interval of checks of an empty queue
FLUSH_PERIOD = 0.5  # s, wall: largest loss in a crash


class RunRecord:
    """Writes a bag in a thread of its own.

    Args:
        folder: the new bag.
        topics: the topics written.
        waits: whether `add_message` waits for room, as in lock-step, or drops and counts.

    Attributes:
        dropped: messages that did not fit into the queue.
        missing: ticks of a run that were never put.

    Raises:
        Refusal: the folder exists, or cannot be made.
    """

    def __init__(self, folder: Path, topics: list[Topic], waits: bool) -> None:
        self.dropped = 0
        self.missing = 0
        self._folder, self._waits = folder, waits
        self._bag = BagWriter(folder)
        self._numbers = {topic.name: self._bag.add_topic(topic) for topic in topics}
        self._states = 0
        self._tick = -1
        self._newest = 0  # wall time [ns] of the newest message
        self._failure: OSError | MemoryError | None = None
        self._finished = False
        # Appending and popping are safe between threads.
        self._waiting: deque[tuple[int, int, bytes]] = deque()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._write_queue, name="run record", daemon=True)
        self._thread.start()
        atexit.register(self._finish_bag)  # in case `close` is not called

    @property
    def trouble(self) -> str:
        """Missing messages and the reason, as text; empty if the bag is complete."""
        words = []
        if self._failure is not None:
            words.append(_describe_failure(self._failure))
        if self._finished and not self._bag.is_complete:
            words.append(f"it needs room, and `arm_emulator repair {self._folder}`")
        if self.dropped:
            words.append(f"{self.dropped} messages were dropped, the disk is too slow")
        if self.missing:
            words.append(f"{self.missing} ticks came too fast to be recorded")
        return "; ".join(words)

    def add_message(self, topic: str, data: bytes, at: int | None = None) -> None:
        """Queue a message; from now on only a failing disk can lose it.

        Args:
            topic: of it.
            data: its bytes.
            at: wall time at which it came, or was published [ns]; None: now.
        """
        while self._waits and len(self._waiting) >= CAPACITY and self._failure is None:
            time.sleep(BREATH)
        if len(self._waiting) >= CAPACITY or self._failure is not None:
            self.dropped += self._failure is None
            return
        # Answers come after their questions, even if wall time is set back.
        self._newest = max(self._newest + 1, time.time_ns() if at is None else at)
        self._waiting.append((self._numbers[topic], self._newest, data))

    def count_tick(self, tick: int) -> None:
        """Count the state of a tick that is queued, or queued again."""
        if tick > self._tick + 1:
            self.missing += tick - self._tick - 1
        self._states += tick != self._tick
        self._tick = tick

    def close(self) -> None:
        """Write the queue, end the bag and print a summary line.

        Raises:
            Refusal: the bag is incomplete.
        """
        atexit.unregister(self._finish_bag)
        self._finish_bag()
        messages = sum(topic.count for topic in self._bag.topics)
        states = "" if self._failure else f", {self._states} motor states"
        print(f"{self._folder}: {messages} messages{states}", flush=True)
        if self.trouble:
            where = f"record {self._folder}"
            raise Refusal(where, "the bag", "contain all published messages", self.trouble)

    def _finish_bag(self) -> None:
        self._stop.set()
        self._thread.join()
        try:
            self._bag.close()
        except (OSError, MemoryError) as error:
            self._failure = self._failure or error
        self._finished = True

    def _write_queue(self) -> None:
        flush_at = time.monotonic() + FLUSH_PERIOD
        while self._waiting or not self._stop.is_set():
            try:
                waiting = len(self._waiting)
                for _ in range(min(max(SMALL, int(PART * waiting)), waiting)):
                    number, now, data = self._waiting.popleft()
                    self._bag.write_message(number, now, now, data)
                if time.monotonic() > flush_at:
                    self._bag.flush()
                    flush_at = time.monotonic() + FLUSH_PERIOD
            except (OSError, MemoryError) as error:
                self._failure = error
                self._waiting.clear()
                return
            time.sleep(BREATH if self._waiting else IDLE)


def _describe_failure(failure: OSError | MemoryError) -> str:
    if isinstance(failure, MemoryError):
        return "no memory is left"
    return f"the disk takes no more: {failure.strerror or failure}"
