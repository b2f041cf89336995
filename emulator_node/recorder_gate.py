"""Recorders that have to keep up: in lock-step, time waits for them.

No message to a recorder is lost as long as it is not further behind than the publishers' queues.
The emulator therefore leaves tick 0 when every recorder has written it, and later stays within
`AHEAD` messages of the slowest. It no longer waits for a recorder that makes no progress, and
reports it.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.node.node_shell import QUEUE_DEPTH
from arm_emulator.ros.recording.recorder_presence import RECORDER

AHEAD = 100  # messages on motor_states: 0.1 s of logical time at a servo period of 1 ms
FAR = 2**62  # ticks
PATIENCE = 120.0  # s, wall: for a recorder that writes nothing, on a machine that is very busy


@dataclass
class _GatedRecorder:
    written: int = 0  # publication number of the newest message on motor_states that is written
    local: bool = False  # it runs on this machine, and was seen there
    behind_since: float | None = None  # wall time, since when the machine waits for it
    let_go: bool = False


class RecorderGate:
    """Compares the messages on `motor_states` with the progress of recorders.

    Args:
        present: names the recorders on this machine, see `recorder_presence`.
        waits: whether time waits for recorders; in real time it does not.
        report: gets events of recorders, as sentences.
        now: clock [s].

    Attributes:
        published: messages on `motor_states` so far; the first one is number 1.
        waited_for: the recorder that has to catch up before the machine advances, or empty.
    """

    def __init__(
        self,
        present: Callable[[], set[str]],
        waits: bool,
        report: Callable[[str], None],
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.published, self.waited_for = 0, ""
        self._present, self._waits, self._report, self._now = present, waits, report, now
        self._recorders: dict[str, _GatedRecorder] = {}
        self._begin = 1  # number of the first message of this run

    def begin_run(self) -> None:
        """Count the next message as the first one of a run."""
        self._begin = self.published + 1

    @property
    def names(self) -> list[str]:
        """Recorders for which the machine waits when they are behind."""
        return [name for name, recorder in self._recorders.items() if not recorder.let_go]

    def take_report(self, name: str, written: int, leaving: bool) -> None:
        """Take a recorder's report; a recorder with an impossible report is not waited for.

        Raises:
            Refusal: it does not come from a recorder.
        """
        if not RECORDER.fullmatch(name):
            raise Refusal("emulator/recorders", "recorder", "be a recorder's name", name[:80])
        if leaving or written > self.published:
            self._recorders.pop(name, None)
            return
        if name not in self._recorders:
            self._recorders[name] = _GatedRecorder(local=name in self._present())
        recorder = self._recorders[name]
        if recorder.let_go:
            self._report(f"recorder {name} is back; its bag has a gap")
            recorder.let_go = False
        if written > recorder.written:
            recorder.written, recorder.behind_since = written, None

    def is_closed(self, at_start: bool) -> bool:
        """Return whether a recorder has to catch up before the machine may leave this tick.

        Args:
            at_start: it is tick 0.
        """
        self.waited_for = ""
        if not self._waits:
            return False
        if at_start:
            for name in self._present():
                self._recorders.setdefault(name, _GatedRecorder()).local = True
        needed, now = self._begin if at_start else self.published - AHEAD, self._now()
        for name, recorder in list(self._recorders.items()):
            # A recorder that comes later cannot lose the start: it counts from its first message
            # on.
            late = recorder.written == 0 and not at_start
            if recorder.let_go or late or recorder.written >= needed:
                continue
            if recorder.behind_since is None:
                recorder.behind_since = now
            if recorder.local and name not in self._present():
                del self._recorders[name]
                self._report(f"recorder {name} has ended; its bag may need `repair`")
            elif now - recorder.behind_since > PATIENCE:
                recorder.let_go = True
                self._report(
                    f"recorder {name} has written nothing for {PATIENCE:g} s; the machine does not "
                    "wait for it any more"
                )
            else:
                self.waited_for = name
        return bool(self.waited_for)

    def count_free_ticks(self) -> int:
        """Return how many ticks behind tick 0 may be left before a recorder has to catch up."""
        waited_for = [
            value.written
            for value in self._recorders.values()
            if value.written and not value.let_go
        ]
        return max(0, min(waited_for) + AHEAD - self.published + 1) if waited_for else FAR

    def find_full_recorder(self) -> str:
        """Return the recorder that would lose one more motor state, or ""."""
        for name, recorder in self._recorders.items():
            is_full = recorder.written and self.published - recorder.written >= QUEUE_DEPTH
            if self._waits and is_full and not recorder.let_go:
                return name
        return ""
