"""Notices when joint targets or motor states stop coming, and decides what a drive does then."""

from __future__ import annotations

import enum
import math

from words.refusal import Refusal


class WatchdogState(enum.Enum):
    """What the drive shall do."""

    OK = "ok"  # follow the targets
    HOLD = "hold"  # hold the angles measured when this began
    CUT = "cut"  # no voltage


class Watchdog:
    """Targets or states silent: hold first, then cut the power.

    - No target has come yet: HOLD. A drive that was switched on waits where it stands, for ever.
    - Silence longer than ``hold_after``: HOLD, until both come again.
    - Silence longer than ``cut_after``: CUT, until `reset`. Power that was cut does not come back
      by itself: whoever restarts a silent controller may have a hand in the machine, and the arm
      has meanwhile sunk to where the last target no longer fits.
    - A clock that jumps back (an emulator that was reset) starts the silence anew.

    Time is that of any clock that all calls share, logical or wall. States stop logical time, so
    only a wall clock notices their silence.

    Args:
        hold_after: silence that leads to HOLD [s].
        cut_after: silence that leads to CUT, longer than `hold_after` [s].

    Raises:
        Refusal: times that are not positive or not in this order.
    """

    def __init__(self, hold_after: float, cut_after: float) -> None:
        if not (math.isfinite(hold_after) and hold_after > 0.0):
            raise Refusal("watchdog", "hold_after", "be a number > 0 s", hold_after)
        if not (math.isfinite(cut_after) and cut_after > hold_after):
            raise Refusal("watchdog", "cut_after", f"be > hold_after = {hold_after} s", cut_after)
        self.hold_after = hold_after
        self.cut_after = cut_after
        self.reset()

    def reset(self) -> None:
        """Forget everything, a cut too."""
        self.state = WatchdogState.HOLD
        self.reason = "no joint target has come yet"
        self._last: dict[str, float | None] = {"joint target": None, "motor state": None}

    def target_came(self, now: float) -> None:
        """Take note of a joint target at time `now` [s]."""
        self._last["joint target"] = now

    def state_came(self, now: float) -> None:
        """Take note of a motor state at time `now` [s]."""
        self._last["motor state"] = now

    def check(self, now: float) -> WatchdogState:
        """Return what to do at time `now` [s]; `reason` is the reason in words."""
        if self.state is WatchdogState.CUT:
            return self.state
        self.state, self.reason = WatchdogState.OK, "targets and states come"
        if self._last["joint target"] is None:
            self.state, self.reason = WatchdogState.HOLD, "no joint target has come yet"
        for what, last in self._last.items():
            if last is None:
                continue
            if last > now:
                self._last[what] = last = now
            silence = now - last
            if silence > self.cut_after:
                self.state = WatchdogState.CUT
                self.reason = (
                    f"no {what} for {silence:.3g} s, more than cut_after = {self.cut_after:g} s; "
                    "the power stays off until a reset"
                )
                break
            if silence > self.hold_after:
                self.state = WatchdogState.HOLD
                self.reason = (
                    f"no {what} for {silence:.3g} s, more than hold_after = {self.hold_after:g} s"
                )
        return self.state
