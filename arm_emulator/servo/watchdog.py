"""Notices when joint targets or motor states stop coming, and decides what a drive does then."""

from __future__ import annotations

import enum
from dataclasses import replace

from arm_emulator.base.validation.number import list_numbers
from arm_emulator.servo.servo_config import ServoConfig
from arm_emulator.servo.servo_law import (
    CUT,
    FOLLOWS,
    HEARS,
    HOLDS,
    LATE_TARGET,
    NO_TARGET,
    SERVO,
    servo_law,
)
from arm_emulator.toolchain.c_header import CData

_NANOSECONDS = 1e9
_LONGEST = 2**62  # ns, which no run lasts


class WatchdogState(enum.Enum):
    """Action of the drive."""

    OK = "ok"  # follow the targets
    HOLD = "hold"  # hold the angles measured when this began
    CUT = "cut"  # no voltage


DOES = {FOLLOWS: WatchdogState.OK, HOLDS: WatchdogState.HOLD, CUT: WatchdogState.CUT}


class Watchdog:
    """The watchdog of arm_emulator/servo/c/servo.h, in words.

    Time is that of any clock that all calls share, logical or wall. States stop logical time, so
    only a wall clock notices their silence.

    Args:
        hold_after: silence that leads to HOLD [s].
        cut_after: silence that leads to CUT, longer than `hold_after` [s].
        of: pointer to that of a servo, which must outlive this; None: one of its own.

    Raises:
        Refusal: times that are not positive or not in this order.
    """

    def __init__(self, hold_after: float, cut_after: float, of: CData | None = None) -> None:
        self._law = servo_law()
        self._dog = SERVO.new("servo_watchdog") if of is None else of
        self.retune(hold_after, cut_after)
        self.reset()

    def retune(self, hold_after: float, cut_after: float) -> None:
        """Go on with other times.

        Raises:
            Refusal: as the constructor. Nothing has changed then.
        """
        numbers = list_numbers(ServoConfig)
        hold_after = numbers["hold_after"].take("watchdog", hold_after)
        cut_after = replace(numbers["cut_after"], above=hold_after).take("watchdog", cut_after)
        self._hold_after, self._cut_after = hold_after, cut_after
        self._dog.hold_after, self._dog.cut_after = (
            nanoseconds(hold_after),
            nanoseconds(cut_after),
        )

    def reset(self) -> None:
        """Forget everything, a cut too."""
        self._law.servo_watchdog_reset(self._dog)

    def target_came(self, now: float) -> None:
        """Take note of a joint target at time `now` [s]."""
        self._law.servo_watchdog_target(self._dog, nanoseconds(now))

    def state_came(self, now: float) -> None:
        """Take note of a motor state at time `now` [s]."""
        self._law.servo_watchdog_state(self._dog, nanoseconds(now))

    def check(self, now: float) -> WatchdogState:
        """Return what to do at time `now` [s]; `reason` is the reason in words."""
        self._law.servo_watchdog_check(self._dog, nanoseconds(now))
        return self.state

    @property
    def state(self) -> WatchdogState:
        """Its newest request."""
        return DOES[self._dog.does]

    @property
    def reason(self) -> str:
        """Why, in words."""
        cause = self._dog.cause
        if cause == HEARS:
            return "targets and states come"
        if cause == NO_TARGET:
            return "no joint target has come yet"
        what = "joint target" if cause == LATE_TARGET else "motor state"
        silence = f"no {what} for {self._dog.silence / _NANOSECONDS:.3g} s, more than"
        if self._dog.does == CUT:
            return f"{silence} cut_after = {self._cut_after:g} s; the power stays off until a reset"
        return f"{silence} hold_after = {self._hold_after:g} s"


def nanoseconds(seconds: float) -> int:
    """Return a time as the law in C counts it."""
    return min(round(seconds * _NANOSECONDS), _LONGEST)
