"""A motion at another pace, and one that continues after a standstill."""

import numpy as np

from arm_emulator.motion.model.joint_reference import Reference, ReferenceMotion
from arm_emulator.motion.trajectory.joint_curve import JointCurve
from arm_emulator.motion.trajectory.online_trajectory import Rest
from arm_emulator.motion.trajectory.timed_path import JointPathLimits, TimedPath

_LOOKS = 40
_SHORTEST, _LONGEST = 0.05, 1e3  # s, in which the pace changes
_ROUNDING = 1e-6  # of a limit
_SLID = 0.5  # s of the motion in which the place nearest to a standing arm is searched
_PLACES = 100
_RESUMED = 0.95  # of the motion's own pace: what is left of its limits is for taking up the pace


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
        self,
        motion: ReferenceMotion,
        since: float,
        pace: float,
        then: float,
        limits: JointPathLimits,
    ) -> None:
        self._motion, self._end = motion, motion.duration
        self._since = min(since, self._end)
        self._pace, self._then = pace, then
        self._ramp = _SHORTEST
        while self._ramp < _LONGEST and not self._is_within_limits(limits):
            self._ramp *= 1.5
        self.duration = self._compute_duration()

    def map_time(self, time: float) -> float:
        """Return the time within the motion after a time [s]."""
        return self._compute_place(time)[0]

    def evaluate_at(self, time: float) -> Reference:
        """Return the joints at a time since its begin [s]."""
        place, rate, change, bend = self._compute_place(time)
        original = self._motion.evaluate_at(place)
        jerk = None
        if original.jerk is not None:
            jerk = original.jerk * rate**3 + 3.0 * original.a * rate * change + original.v * bend
        return Reference(
            original.q, original.v * rate, original.a * rate**2 + original.v * change, jerk
        )

    def _compute_place(self, time: float) -> tuple[float, float, float, float]:
        """Return the place of the motion [s], and its first three derivatives by time."""
        T, by = self._ramp, self._then - self._pace
        x = min(1.0, time / T)
        gained = by * T * x**3 * (1.0 - 0.5 * x) + by * max(0.0, time - T)
        place = min(self._end, self._since + self._pace * time + gained)
        if x >= 1.0:
            return place, self._then, 0.0, 0.0
        change, bend = by * 6.0 * x * (1.0 - x) / T, by * 6.0 * (1.0 - 2.0 * x) / T**2
        return place, self._pace + by * x * x * (3.0 - 2.0 * x), change, bend

    def _is_within_limits(self, limits: JointPathLimits) -> bool:
        """Whether the pace changes within the limits, or those of the motion itself."""
        for time in np.linspace(0.0, min(self._ramp, self._compute_duration()), _LOOKS):
            scaled, original = (
                self.evaluate_at(float(time)),
                self._motion.evaluate_at(self.map_time(float(time))),
            )
            pairs = [
                (scaled.v, original.v, limits.speed),
                (scaled.a, original.a, limits.acceleration),
            ]
            if scaled.jerk is not None and original.jerk is not None:
                pairs.append((scaled.jerk, original.jerk, limits.jerk))
            for value, original_value, limit in pairs:
                if (
                    np.abs(value) > np.maximum(limit, np.abs(original_value)) * (1.0 + _ROUNDING)
                ).any():
                    return False
        return True

    def _compute_duration(self) -> float:
        """Return its duration [s]."""
        T = self._ramp
        left = self._end - self._since - 0.5 * (self._pace + self._then) * T
        if left >= 0.0:
            return T + left / self._then if self._then else T
        low, high = 0.0, T
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.map_time(middle) < self._end else (low, middle)
        return high


class Resumed:
    """Returns to the way of a motion along the joints' line, and continues along it from rest.

    Args:
        motion: that was interrupted.
        since: time within it at the interruption [s].
        now: joints at rest.
        limits: of the joints.

    Attributes:
        duration: [s].
        path_text: kind of its way, as text.
    """

    def __init__(
        self, motion: ReferenceMotion, since: float, now: Reference, limits: JointPathLimits
    ) -> None:
        since = min(since, motion.duration)
        times = np.linspace(since, min(motion.duration, since + _SLID), _PLACES)
        off = [float(np.abs(motion.evaluate_at(float(t)).q - now.q).max()) for t in times]
        nearest = float(times[int(np.argmin(off))])
        to = motion.evaluate_at(nearest).q
        apart = np.abs(to - now.q).max() > 1e-12
        self._back: ReferenceMotion = (
            TimedPath(JointCurve.make_line(now.q, to), limits) if apart else Rest(to)
        )
        self._along = TimeScaled(motion, nearest, 0.0, _RESUMED, limits)
        self.duration = self._back.duration + self._along.duration
        self.path_text = f"goes on, in {self.duration:.3g} s"

    def map_time(self, time: float) -> float:
        """Return the time within the motion after a time [s]."""
        return self._along.map_time(max(0.0, time - self._back.duration))

    def evaluate_at(self, time: float) -> Reference:
        """Return the joints at a time since its begin [s]."""
        resumed_for = time - self._back.duration
        return (
            self._back.evaluate_at(time)
            if resumed_for <= 0.0
            else self._along.evaluate_at(resumed_for)
        )
