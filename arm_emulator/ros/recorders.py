"""Progress of the recorders: in lock-step, time waits for them.

No message to a recorder is lost as long as it is not further behind than the publishers' queues.
The emulator therefore leaves tick 0 when every recorder has written it, and later stays within
`AHEAD` messages of the slowest. It no longer waits for a recorder that makes no progress, and
reports it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.recorder_presence import RECORDER

AHEAD = 100  # messages on motor_states: 0.1 s of logical time at a servo period of 1 ms
FAR = 2**62  # ticks
PATIENCE = 120.0  # s, wall: for a recorder that writes nothing, on a machine that is very busy


@dataclass
class _Recorder:
    written: int = 0  # publication number of the newest message on motor_states that is written
    local: bool = False  # it runs on this machine, and was seen there
    behind_since: float | None = None  # wall time, since when the machine waits for it
    let_go: bool = False


class Recorders:
    """Compares the messages on `motor_states` with the progress of recorders.

    Args:
        present: names the recorders on this machine, see `recorder_presence`.

    Attributes:
        published: messages on `motor_states` so far; the first one is number 1.
        news: events of recorders, as sentences; cleared when published.
    """

    def __init__(self, present: Callable[[], set[str]]) -> None:
        self.published = 0
        self.news: list[str] = []
        self._present = present
        self._known: dict[str, _Recorder] = {}
        self._begin = 1  # number of the first message of this run

    def begin(self) -> None:
        """Count the next message as the first one of a run."""
        self._begin = self.published + 1

    @property
    def names(self) -> list[str]:
        """Recorders for which the machine waits when they are behind."""
        return [name for name, one in self._known.items() if not one.let_go]

    def report(self, name: str, written: int, leaving: bool) -> None:
        """Take a recorder's report; a recorder with an impossible report is not waited for.

        Raises:
            Refusal: it does not come from a recorder.
        """
        if not RECORDER.fullmatch(name):
            raise Refusal("emulator/recorders", "recorder", "be a recorder's name", name[:80])
        if leaving or written > self.published:
            self._known.pop(name, None)
            return
        if name not in self._known:
            self._known[name] = _Recorder(local=name in self._present())
        one = self._known[name]
        if one.let_go:
            self.news.append(f"recorder {name} is back; its bag has a gap")
            one.let_go = False
        if written > one.written:
            one.written, one.behind_since = written, None

    def behind(self, at_start: bool, now: float) -> str:
        """Return the name of a recorder that has to catch up first; empty: none.

        Args:
            at_start: the machine is about to leave tick 0.
            now: wall time [s].
        """
        if at_start:
            for name in self._present():
                self._known.setdefault(name, _Recorder()).local = True
        needed = self._begin if at_start else self.published - AHEAD
        waited_for = ""
        for name, one in list(self._known.items()):
            # A recorder that comes later cannot lose the start: it counts from its first message
            # on.
            late = one.written == 0 and not at_start
            if one.let_go or late or one.written >= needed:
                continue
            if one.behind_since is None:
                one.behind_since = now
            if one.local and name not in self._present():
                del self._known[name]
                self.news.append(f"recorder {name} has ended; its bag may need `repair`")
            elif now - one.behind_since > PATIENCE:
                one.let_go = True
                self.news.append(
                    f"recorder {name} has written nothing for {PATIENCE:g} s; the machine does not "
                    "wait for it any more"
                )
            else:
                waited_for = name
        return waited_for

    def room(self) -> int:
        """Return how many ticks behind tick 0 may be left before `behind` names a recorder."""
        waited_for = [
            value.written for value in self._known.values() if value.written and not value.let_go
        ]
        return max(0, min(waited_for) + AHEAD - self.published + 1) if waited_for else FAR

    def without_room(self, depth: int) -> str:
        """Return a recorder that would lose one more message at this `depth`, or ""."""
        for name, one in self._known.items():
            if one.written and not one.let_go and self.published - one.written >= depth:
                return name
        return ""
