"""A limit of how fast logical time passes, beside the wall clock."""

from __future__ import annotations

import time
from collections.abc import Callable

BEHIND = 0.1  # s, wall: time that was lost beyond this is not made up for
UNLIMITED = 2**62  # ticks


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

    def due(self, tick: int) -> float:
        """Return the wall time until a tick may be left [s]; 0 or less: now."""
        if not self._factor:
            return 0.0
        now, wall_period = self._now(), self._period / self._factor
        wait = self._begun + (tick + 1 - self._first) * wall_period - now
        # Time was changed, stood still, or began anew.
        if self._first < 0 or not -BEHIND - wall_period < wait <= wall_period + BEHIND:
            self._begun, self._first, wait = now, tick, wall_period
        return wait

    def room(self, tick: int) -> int:
        """Return how many ticks may be left now, from a tick on."""
        if not self._factor:
            return UNLIMITED
        wait = self.due(tick)
        return 0 if wait > 0.0 else 1 + int(-wait * self._factor / self._period)
