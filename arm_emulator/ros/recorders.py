"""The recorders of this machine and their progress: in lock-step time waits for them.

Nothing is lost on the way to a recorder as long as it is never further behind than the publishers
keep messages. So the emulator leaves tick 0 when every recorder has written it, and later stays
within `AHEAD` messages of the slowest. A recorder that makes no progress is no longer waited for,
which is reported.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.recorder_presence import RECORDER

AHEAD = 100  # messages on motor_states: 0.1 s of logical time at a servo period of 1 ms
PATIENCE = 120.0  # s, wall: for a recorder that writes nothing, on a machine that is very busy


@dataclass
class _Recorder:
    written: int = 0  # publication number of the newest message on motor_states that is written
    local: bool = False  # it runs on this machine, and was seen there
    behind_since: float | None = None  # wall time, since when the machine waits for it
    let_go: bool = False


class Recorders:
    """Counts the messages on `motor_states` against what recorders have written of them.

    Args:
        present: names the recorders on this machine, see `recorder_presence`.

    Attributes:
        published: messages on `motor_states` so far; the first one is number 1.
        news: events of recorders, in sentences; cleared by whoever publishes them.
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
        """Those that are waited for when they are behind."""
        return [name for name, one in self._known.items() if not one.let_go]

    def report(self, name: str, written: int, leaving: bool) -> None:
        """Take a recorder's report; a recorder whose report is impossible is not waited for.

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
        """Return the name of a recorder that has to catch up first; empty: all have.

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
            # One that comes later has no start to lose: it is waited for from its first message on.
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

    def without_room(self, depth: int) -> str:
        """Return a recorder that one more message would outrun at this `depth`, or "" if none."""
        for name, one in self._known.items():
            if one.written and not one.let_go and self.published - one.written >= depth:
                return name
        return ""
