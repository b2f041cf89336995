"""The part of a run that a page shows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from arm_emulator.page.signal_history import SignalHistory
from arm_emulator.runs.timeline import Timeline


@dataclass(frozen=True)
class Subject:
    """A run up to some tick.

    Attributes:
        line: timeline of a run with `session`.
        last: last tick that can be visited.
        history: signals up to there.
        events: ticks and texts of what happened.
    """

    line: Timeline[Any]
    last: int
    history: SignalHistory
    events: tuple[tuple[int, str], ...]

    @classmethod
    def of(
        cls, line: Timeline[Any], last: int, events: tuple[tuple[int, str], ...] | None = None
    ) -> Subject:
        """Return a run from its first tick on; its events are its changes if none are given."""
        at = line.tick
        line.go_to(line.first)
        history = SignalHistory(line, last)
        line.go_to(at)
        made = tuple((one.tick, one.name) for one in line.changes) if events is None else events
        return cls(line, last, history, made)
