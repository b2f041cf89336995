"""A motion that continues after a standstill."""

from __future__ import annotations

import numpy as np

from arm_emulator.motion.joint_curve import JointCurve
from arm_emulator.motion.reference import Reference
from arm_emulator.motion.take_over import Rest
from arm_emulator.motion.way import Way, WayLimits
from arm_emulator.motion.way_controller import Motion

_SLID = 0.5  # s of the motion in which the place nearest to the arm is searched
_LOOKS = 100
_PACE = 0.95  # of the motion's own: what is left of its limits is for taking up the pace
_SHORTEST, _LONGEST = 0.05, 1e3  # s, in which the pace is taken up
_ROUNDING = 1e-6  # of a limit


class GoingOn:
    """Returns to the way of a motion along the joints' line, and continues along it from rest.

    Args:
        motion: that was interrupted.
        since: time within it at the interruption [s].
        now: joints at rest.
        limits: of the joints.

    Attributes:
        duration: [s].
    """

    def __init__(self, motion: Motion, since: float, now: Reference, limits: WayLimits) -> None:
        self._motion, self._end = motion, motion.duration
        since = min(since, self._end)
        times = np.linspace(since, min(self._end, since + _SLID), _LOOKS)
        off = [float(np.abs(motion.at(float(t)).q - now.q).max()) for t in times]
        self._since = float(times[int(np.argmin(off))])
        to = motion.at(self._since).q
        apart = np.abs(to - now.q).max() > 1e-12
        self._back: Motion = Way(JointCurve.line(now.q, to), limits) if apart else Rest(to)
        self._ramp = _SHORTEST
        while self._ramp < _LONGEST and not self._keeps(limits):
            self._ramp *= 1.5
        self.duration = self._back.duration + self._takes()

    def place(self, time: float) -> float:
        """Return the time within the motion after a time [s]."""
        return self._pace(max(0.0, time - self._back.duration))[0]

    def at(self, time: float) -> Reference:
        """Return the joints at a time since its begin [s]."""
        gone = time - self._back.duration
        return self._back.at(time) if gone <= 0.0 else self._along(gone)

    def _pace(self, time: float) -> tuple[float, float, float, float]:
        """Return the place of the motion [s], and its first three derivatives by time."""
        T, x = self._ramp, time / self._ramp
        if x >= 1.0:
            return min(self._end, self._since + _PACE * (time - 0.5 * T)), _PACE, 0.0, 0.0
        place = self._since + _PACE * T * x**3 * (1.0 - 0.5 * x)
        rate = _PACE * x * x * (3.0 - 2.0 * x)
        change, bend = _PACE * 6.0 * x * (1.0 - x) / T, _PACE * 6.0 * (1.0 - 2.0 * x) / T**2
        return min(self._end, place), rate, change, bend

    def _along(self, time: float) -> Reference:
        place, rate, change, bend = self._pace(time)
        one = self._motion.at(place)
        jerk = None
        if one.jerk is not None:
            jerk = one.jerk * rate**3 + 3.0 * one.a * rate * change + one.v * bend
        return Reference(one.q, one.v * rate, one.a * rate**2 + one.v * change, jerk)

    def _keeps(self, limits: WayLimits) -> bool:
        """Whether the pace is taken up within the limits, or those of the motion itself."""
        for time in np.linspace(0.0, min(self._ramp, self._takes()), _LOOKS):
            one, itself = self._along(float(time)), self._motion.at(self._pace(float(time))[0])
            pairs = [(one.v, itself.v, limits.speed), (one.a, itself.a, limits.acceleration)]
            if one.jerk is not None and itself.jerk is not None:
                pairs.append((one.jerk, itself.jerk, limits.jerk))
            for value, own, limit in pairs:
                if (np.abs(value) > np.maximum(limit, np.abs(own)) * (1.0 + _ROUNDING)).any():
                    return False
        return True

    def _takes(self) -> float:
        """Return its duration along the way [s]."""
        left, T = self._end - self._since, self._ramp
        if left >= 0.5 * _PACE * T:
            return left / _PACE + 0.5 * T
        low, high = 0.0, T
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._pace(middle)[0] < self._end else (low, middle)
        return high
