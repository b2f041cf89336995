"""A limit of how fast logical time passes, beside the wall clock."""

import math
import time
from collections.abc import Callable

from arm_emulator.base.refusal import Refusal

BEHIND = 0.1  # s, wall: time that was lost beyond this is not made up for
UNLIMITED = 2**62  # ticks
# s, wall: shorter servo periods are left together, so that an idle network wakes 200 times a second
# at most, and not for each of them. Their mean rate is that of the pace.
GRAIN = 5e-3
ROUNDING = 1e-6  # of a grain or a period


FASTEST = "max"
SMALLEST, LARGEST = 1e-6, 1000.0  # times real time


def parse_factor(where: str, text: str) -> float:
    """Return the factor of a pace as people write it: a number, or `FASTEST` (0).

    Raises:
        Refusal: something else.
    """
    try:
        factor = 0.0 if text == FASTEST else float(text)
    except ValueError:
        factor = math.nan
    if not (text == FASTEST or SMALLEST <= factor <= LARGEST):
        rule = f"be {FASTEST}, or times real time, at least {SMALLEST:g} and at most {LARGEST:g}"
        raise Refusal(where, "pace", rule, text)
    return factor


class Pace:
    """Ticks that may be left by now. Bits do not depend on it.

    Args:
        period: servo period [s].
        now: wall clock [s].
    """

    def __init__(self, period: float, now: Callable[[], float] = time.monotonic) -> None:
        self._period, self._now = period, now
        self._factor = 0.0
        self._begun, self._first = now(), 0

    @property
    def factor(self) -> float:
        """Logical time per wall time, at most; 0: as fast as possible."""
        return self._factor

    @factor.setter
    def factor(self, value: float) -> None:
        self._factor = value
        self._first = -1

    def compute_wait(self, tick: int) -> float:
        """Return the wall time until a tick may be left [s]; 0 or less: now."""
        if not self._factor:
            return 0.0
        now, wall_period = self._now(), self._period / self._factor
        wait = self._begun + self._round_up((tick + 1 - self._first) * wall_period) - now
        # Time was changed, stood still, or began anew.
        longest = max(wall_period, GRAIN) + BEHIND
        if self._first < 0 or not -BEHIND - wall_period < wait <= longest:
            self._begun, self._first = now, tick
            wait = self._round_up(wall_period)
        return wait

    def count_ticks_left(self, tick: int) -> int:
        """Return how many ticks may be left now, from a tick on."""
        if not self._factor:
            return UNLIMITED
        if self.compute_wait(tick) > 0.0:
            return 0
        elapsed, wall_period = self._now() - self._begun, self._period / self._factor
        if wall_period < GRAIN:
            elapsed = math.floor(elapsed / GRAIN + ROUNDING) * GRAIN
        return max(1, math.floor(elapsed / wall_period + ROUNDING) - (tick - self._first))

    def _round_up(self, wall: float) -> float:
        """Return a wall time since the begin, rounded up to the grain of short periods [s]."""
        if self._period / self._factor >= GRAIN:
            return wall
        return math.ceil(wall / GRAIN - ROUNDING) * GRAIN
