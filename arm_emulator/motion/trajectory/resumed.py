"""A motion that continues after a standstill."""

from __future__ import annotations

import numpy as np

from arm_emulator.motion.model.joint_reference import Motion, Reference
from arm_emulator.motion.trajectory.joint_curve import JointCurve
from arm_emulator.motion.trajectory.online_trajectory import Rest
from arm_emulator.motion.trajectory.time_scaling import TimeScaled
from arm_emulator.motion.trajectory.timed_path import JointPathLimits, TimedPath

_SLID = 0.5  # s of the motion in which the place nearest to the arm is searched
_LOOKS = 100
_PACE = 0.95  # of the motion's own: what is left of its limits is for taking up the pace


class Resumed:
    """Returns to the way of a motion along the joints' line, and continues along it from rest.

    Args:
        motion: that was interrupted.
        since: time within it at the interruption [s].
        now: joints at rest.
        limits: of the joints.

    Attributes:
        duration: [s].
    """

    def __init__(
        self, motion: Motion, since: float, now: Reference, limits: JointPathLimits
    ) -> None:
        since = min(since, motion.duration)
        times = np.linspace(since, min(motion.duration, since + _SLID), _LOOKS)
        off = [float(np.abs(motion.at(float(t)).q - now.q).max()) for t in times]
        nearest = float(times[int(np.argmin(off))])
        to = motion.at(nearest).q
        apart = np.abs(to - now.q).max() > 1e-12
        self._back: Motion = TimedPath(JointCurve.line(now.q, to), limits) if apart else Rest(to)
        self._along = TimeScaled(motion, nearest, 0.0, _PACE, limits)
        self.duration = self._back.duration + self._along.duration

    def place(self, time: float) -> float:
        """Return the time within the motion after a time [s]."""
        return self._along.place(max(0.0, time - self._back.duration))

    def at(self, time: float) -> Reference:
        """Return the joints at a time since its begin [s]."""
        gone = time - self._back.duration
        return self._back.at(time) if gone <= 0.0 else self._along.at(gone)
