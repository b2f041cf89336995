"""A motion at another pace."""

from __future__ import annotations

import numpy as np

from arm_emulator.motion.model.joint_reference import Motion, Reference
from arm_emulator.motion.trajectory.timed_path import JointPathLimits

_LOOKS = 40
_SHORTEST, _LONGEST = 0.05, 1e3  # s, in which the pace changes
_ROUNDING = 1e-6  # of a limit


class TimeScaled:
    """A motion whose pace changes smoothly at once, as fast as the limits allow, and then stays.

    Args:
        motion: as it would be at the pace 1.
        since: time within it where this one begins [s].
        pace: at first.
        then: later; 0 comes to rest on the way.
        limits: of the joints; where the motion itself exceeds them its own values hold.

    Attributes:
        duration: [s].
    """

    def __init__(
        self, motion: Motion, since: float, pace: float, then: float, limits: JointPathLimits
    ) -> None:
        self._motion, self._end = motion, motion.duration
        self._since = min(since, self._end)
        self._pace, self._then = pace, then
        self._ramp = _SHORTEST
        while self._ramp < _LONGEST and not self._keeps(limits):
            self._ramp *= 1.5
        self.duration = self._takes()

    def place(self, time: float) -> float:
        """Return the time within the motion after a time [s]."""
        return self._along(time)[0]

    def at(self, time: float) -> Reference:
        """Return the joints at a time since its begin [s]."""
        place, rate, change, bend = self._along(time)
        one = self._motion.at(place)
        jerk = None
        if one.jerk is not None:
            jerk = one.jerk * rate**3 + 3.0 * one.a * rate * change + one.v * bend
        return Reference(one.q, one.v * rate, one.a * rate**2 + one.v * change, jerk)

    def _along(self, time: float) -> tuple[float, float, float, float]:
        """Return the place of the motion [s], and its first three derivatives by time."""
        T, by = self._ramp, self._then - self._pace
        x = min(1.0, time / T)
        gone = by * T * x**3 * (1.0 - 0.5 * x) + by * max(0.0, time - T)
        place = min(self._end, self._since + self._pace * time + gone)
        if x >= 1.0:
            return place, self._then, 0.0, 0.0
        change, bend = by * 6.0 * x * (1.0 - x) / T, by * 6.0 * (1.0 - 2.0 * x) / T**2
        return place, self._pace + by * x * x * (3.0 - 2.0 * x), change, bend

    def _keeps(self, limits: JointPathLimits) -> bool:
        """Whether the pace changes within the limits, or those of the motion itself."""
        for time in np.linspace(0.0, min(self._ramp, self._takes()), _LOOKS):
            one, itself = self.at(float(time)), self._motion.at(self.place(float(time)))
            pairs = [(one.v, itself.v, limits.speed), (one.a, itself.a, limits.acceleration)]
            if one.jerk is not None and itself.jerk is not None:
                pairs.append((one.jerk, itself.jerk, limits.jerk))
            for value, own, limit in pairs:
                if (np.abs(value) > np.maximum(limit, np.abs(own)) * (1.0 + _ROUNDING)).any():
                    return False
        return True

    def _takes(self) -> float:
        """Return its duration [s]."""
        T = self._ramp
        left = self._end - self._since - 0.5 * (self._pace + self._then) * T
        if left >= 0.0:
            return T + left / self._then if self._then else T
        low, high = 0.0, T
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.place(middle) < self._end else (low, middle)
        return high
