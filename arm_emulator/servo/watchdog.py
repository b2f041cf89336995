"""Notices when joint targets or motor states stop coming, and decides what a drive does then."""

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

    Args:
        hold_after: silence that leads to HOLD [s].
        cut_after: silence that leads to CUT, longer than `hold_after` [s].
        dog: pointer to that of a servo, which must outlive this.

    Raises:
        Refusal: times that are not positive or not in this order.
    """

    def __init__(self, hold_after: float, cut_after: float, dog: CData) -> None:
        self._dog = dog
        self.set_times(hold_after, cut_after)

    def set_times(self, hold_after: float, cut_after: float) -> None:
        """Go on with other times.

        Raises:
            Refusal: as the constructor. Nothing has changed then.
        """
        numbers = list_numbers(ServoConfig)
        hold_after = numbers["hold_after"].check_value("watchdog", hold_after)
        cut_after = replace(numbers["cut_after"], above=hold_after).check_value(
            "watchdog", cut_after
        )
        self._hold_after, self._cut_after = hold_after, cut_after
        self._dog.hold_after = count_nanoseconds(hold_after)
        self._dog.cut_after = count_nanoseconds(cut_after)

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
        kind = "joint target" if cause == LATE_TARGET else "motor state"
        silence = f"no {kind} for {self._dog.silence / _NANOSECONDS:.3g} s, more than"
        if self._dog.does == CUT:
            return f"{silence} cut_after = {self._cut_after:g} s; the power stays off until a reset"
        return f"{silence} hold_after = {self._hold_after:g} s"


def count_nanoseconds(seconds: float) -> int:
    """Return a time as the law in C counts it."""
    return min(round(seconds * _NANOSECONDS), _LONGEST)
