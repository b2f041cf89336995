"""How fast to go along a path: speeds that change with limited acceleration and jerk.

A path is a row of stretches. Each has a length and a largest speed, and so has each place where
two of them meet. The profile rests at both ends, passes the meeting places without acceleration,
and on each stretch goes as fast as then remains possible: up, on, and down again, each change of
speed in phases of constant jerk (+j, 0, -j).
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable, Sequence

_HALVINGS = 60  # of the range in which a speed is looked for: to the last bits of a double


class SpeedProfile:
    """Distance along a path over time.

    Args:
        lengths: of the stretches (S,), > 0 [m].
        speeds: largest on each (S,), > 0 [m/s].
        meeting: largest where one stretch meets the next (S - 1,), >= 0 [m/s].
        acceleration: largest, > 0 [m/s2].
        jerk: largest, > 0 [m/s3].

    Attributes:
        duration: of the whole [s].
        length: of the whole [m].
    """

    def __init__(
        self,
        lengths: Sequence[float],
        speeds: Sequence[float],
        meeting: Sequence[float],
        acceleration: float,
        jerk: float,
    ) -> None:
        self._acceleration, self._jerk = acceleration, jerk
        passing = self._passing(lengths, speeds, meeting)
        # Phases of constant jerk: time, distance, speed, acceleration where each begins, and jerk.
        self._times: list[float] = []
        self._phases: list[tuple[float, float, float, float]] = []
        time = at = 0.0
        for i, length in enumerate(lengths):
            before, after = passing[i], passing[i + 1]
            top = self._top(length, speeds[i], before, after)
            up, down = self._distance(before, top), self._distance(top, after)
            time = self._change(time, at, before, top)
            on = length - up - down
            if on > 0.0:
                self._begin(time, at + up, top, 0.0, 0.0)
                time += on / top
            time = self._change(time, at + length - down, top, after)
            at += length
        self.duration, self.length = time, at

    def sample(self, time: float) -> tuple[float, float, float]:
        """Return distance [m], speed [m/s] and acceleration [m/s2] at a time since the start."""
        if time <= 0.0 or not self._times:
            return 0.0, 0.0, 0.0
        if time >= self.duration:
            return self.length, 0.0, 0.0
        phase = bisect.bisect_right(self._times, time) - 1
        t = time - self._times[phase]
        s, v, a, j = self._phases[phase]
        s += t * (v + t * (a / 2.0 + t * j / 6.0))
        return min(s, self.length), v + t * (a + t * j / 2.0), a + t * j

    def _begin(self, time: float, s: float, v: float, a: float, j: float) -> None:
        self._times.append(time)
        self._phases.append((s, v, a, j))

    def _change(self, time: float, s: float, before: float, after: float) -> float:
        """Add the phases that change the speed; return when they end."""
        rise, flat = self._phase_times(before, after)
        if rise == 0.0:
            return time
        j = math.copysign(self._jerk, after - before)
        v, a = before, 0.0
        for duration, jerk in ((rise, j), (flat, 0.0), (rise, -j)):
            if duration > 0.0:
                self._begin(time, s, v, a, jerk)
                t = duration
                s += t * (v + t * (a / 2.0 + t * jerk / 6.0))
                v, a, time = v + t * (a + t * jerk / 2.0), a + t * jerk, time + t
        return time

    def _phase_times(self, before: float, after: float) -> tuple[float, float]:
        """Return how long the acceleration rises (and falls), and stays [s]."""
        change = abs(after - before)
        rise = self._acceleration / self._jerk
        if change >= self._acceleration * rise:
            return rise, change / self._acceleration - rise
        return math.sqrt(change / self._jerk), 0.0

    def _distance(self, before: float, after: float) -> float:
        """Return the distance on which the speed changes so much."""
        rise, flat = self._phase_times(before, after)
        return 0.5 * (before + after) * (2.0 * rise + flat)

    def _top(self, length: float, speed: float, before: float, after: float) -> float:
        """Return the largest speed on a stretch that leaves room to slow down."""
        low = max(before, after)
        if self._distance(before, speed) + self._distance(speed, after) <= length:
            return speed
        return _largest(
            low, speed, lambda v: self._distance(before, v) + self._distance(v, after) <= length
        )

    def _passing(
        self, lengths: Sequence[float], speeds: Sequence[float], meeting: Sequence[float]
    ) -> list[float]:
        """Return the speed at the start, wherever two stretches meet, and at the end (S + 1,)."""
        passing = [0.0]
        for i, most in enumerate(meeting):
            passing.append(min(most, speeds[i], speeds[i + 1]))
        passing.append(0.0)
        for i, length in enumerate(lengths):
            passing[i + 1] = self._reachable(passing[i], passing[i + 1], length)
        for i in range(len(lengths) - 1, -1, -1):
            passing[i] = self._reachable(passing[i + 1], passing[i], lengths[i])
        return passing

    def _reachable(self, start: float, wanted: float, length: float) -> float:
        if wanted <= start or self._distance(start, wanted) <= length:
            return wanted
        return _largest(start, wanted, lambda v: self._distance(start, v) <= length)


def _largest(low: float, high: float, holds: Callable[[float], bool]) -> float:
    """Return the largest number from `low` on for which it holds; it does for `low`, or nowhere."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low
