"""Joint trajectories within the limits of speed and acceleration: as they are, slower, or refused.

A trajectory whose speeds step, as those of points without speeds do, comes to rest where they step.
"""

from __future__ import annotations

import itertools
from typing import Protocol

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.model.joint_reference import Motion, Reference
from arm_emulator.motion.planner.target_planner import TargetPlanner
from arm_emulator.motion.planner.tool_path_planner import MotionSequence
from arm_emulator.motion.trajectory.joint_curve import JointCurve
from arm_emulator.motion.trajectory.joint_trajectory import WHERE, JointMotion, JointTrajectory
from arm_emulator.motion.trajectory.resumed import Resumed
from arm_emulator.motion.trajectory.timed_path import JointPathLimits, TimedPath

# A planner's points keep the limits; a spline through them exceeds them a little here and there.
BETWEEN_POINTS = 1.05
_STEP = 1e-3  # of the speed limit: rounding of planners changes speeds by less
_LOOKS = np.linspace(0.0, 1.0, 9)  # places of a piece at which it is held against the limits
_SECONDS = 1e-9


class TimedMotion(Protocol):
    """A joint trajectory over logical time; `JointMotion` keeps the times that were asked for.

    Attributes:
        end_ns: when it ends.
        way: why it takes longer, in words; empty: it does not.
    """

    end_ns: int
    way: str

    def at(self, time_ns: int) -> Reference:
        """Return the joints at a logical time."""

    def asked_ns(self, time_ns: int) -> int:
        """Return the time for which the trajectory gives what holds at a logical time."""


class StretchedTrajectory:
    """A joint trajectory that takes longer than asked."""

    def __init__(
        self, now_ns: int, before: Motion, runs: list[tuple[int, int, TimedPath]], way: str
    ) -> None:
        self._now_ns, self._runs, self.way = now_ns, runs, way
        self._row = MotionSequence([before, *(run for _, _, run in runs)])
        self.end_ns = now_ns + round(self._row.duration / _SECONDS)

    def at(self, time_ns: int) -> Reference:
        """See `TimedMotion`."""
        return self._row.at((time_ns - self._now_ns) * _SECONDS)

    def asked_ns(self, time_ns: int) -> int:
        """See `TimedMotion`."""
        time = (time_ns - self._now_ns) * _SECONDS
        for (begin, end, run), since in zip(self._runs, self._row.begins[1:], strict=False):
            if time < since + run.duration:
                return begin + round(run.place(time - since) * (end - begin))
        return self._runs[-1][1]


class DelayedTrajectory:
    """A joint trajectory that goes on after a standstill.

    Args:
        before: how it went.
        since_ns: until when.
        now_ns: logical time [ns].
        now: joints at rest.
        limits: of the joints.
    """

    def __init__(
        self,
        before: TimedMotion,
        since_ns: int,
        now_ns: int,
        now: Reference,
        limits: JointPathLimits,
    ) -> None:
        self._before, self._since_ns, self._now_ns = before, since_ns, now_ns
        self._left = Resumed(MotionInSeconds(before, since_ns), 0.0, now, limits)
        self.end_ns = now_ns + round(self._left.duration / _SECONDS)
        self.way = f"goes on, in {self._left.duration:.3g} s"

    def at(self, time_ns: int) -> Reference:
        """See `TimedMotion`."""
        return self._left.at((time_ns - self._now_ns) * _SECONDS)

    def asked_ns(self, time_ns: int) -> int:
        """See `TimedMotion`."""
        gone = self._left.place((time_ns - self._now_ns) * _SECONDS)
        return self._before.asked_ns(self._since_ns + round(gone / _SECONDS))


class MotionInSeconds:
    """A motion over logical time as one over the seconds since a moment."""

    def __init__(self, motion: TimedMotion, since_ns: int) -> None:
        self._motion, self._since_ns = motion, since_ns
        self.duration = max(0.0, (motion.end_ns - since_ns) * _SECONDS)

    def at(self, time: float) -> Reference:
        """Return the joints at a time since the moment [s]."""
        return self._motion.at(self._since_ns + round(time / _SECONDS))


def within_limits(
    law: TargetPlanner,
    trajectory: JointTrajectory,
    now_ns: int,
    start_ns: int,
    now: Reference,
    scaled: bool,
) -> JointMotion | StretchedTrajectory:
    """Return the motion of a trajectory.

    Args:
        law: whose arm and limits hold.
        trajectory: that begins.
        now_ns: logical time [ns].
        start_ns: from which its times count [ns].
        now: motion of the joints.
        scaled: whether it may take longer than asked.

    Raises:
        Refusal: it cannot be begun so, or is faster than the limits and must not be scaled.
    """
    motion = trajectory.begin(now_ns, start_ns, now.q, now.v, now.a)
    beyond = "" if trajectory.stops else too_fast(law, motion, now)
    if not beyond:
        return motion
    if not scaled:
        rule = "keep the limits (trajectory_limits: scale makes it slower)"
        raise Refusal(WHERE, "the points", rule, beyond)
    stop = law.stopping(now)
    rest = stop.at(stop.duration)
    still = Reference.at_rest(rest.q)
    motion = trajectory.begin(now_ns, start_ns, still.q, still.v, still.a)
    runs = [
        (
            begin,
            end,
            TimedPath(curve, law.limits, law.arm, asked=(end - begin) * _SECONDS, where=WHERE),
        )
        for begin, end, curve in _runs(law, motion)
    ]
    asked = (motion.end_ns - now_ns) * _SECONDS
    takes = stop.duration + sum(run.duration for _, _, run in runs)
    way = f"in {takes:.3g} s instead of {asked:.3g} s: {beyond}"
    return StretchedTrajectory(now_ns, stop, runs, way)


def too_fast(law: TargetPlanner, motion: JointMotion, now: Reference) -> str:
    """Return the limit that a motion exceeds most, with place and ratio; empty: none."""
    c, T = motion.coefficients, motion.durations[:, None, None]
    limits, names = law.limits, law.kinematics.joint_names
    top = law.top_speed
    worst, words = BETWEEN_POINTS, ""
    steps = _steps(motion, now) / limits.speed
    k, j = np.unravel_index(int(np.argmax(steps)), steps.shape)
    if steps[k, j] > _STEP:
        v = steps[k, j] * limits.speed[j]
        return f"the speed of {names[j]} steps by {v:.3g} rad/s at {_place(motion, int(k))}"
    t = T[:, :, 0] * _LOOKS  # (S, looks)
    for order, limit, what in ((1, top, "rad/s"), (2, limits.acceleration, "rad/s2")):
        powers = np.stack([_falling(d, order) * t ** max(0, d - order) for d in range(6)], axis=2)
        share = np.abs(powers @ c) / limit
        k, look, j = np.unravel_index(int(np.argmax(share)), share.shape)
        if share[k, look, j] > worst:
            worst = float(share[k, look, j])
            words = f"{names[j]} at {worst * limit[j]:.3g} {what} after {_place(motion, int(k))}"
            words += f", its limit is {limit[j]:.3g}"
    return words


def _falling(d: int, order: int) -> float:
    return float(d if order == 1 else d * (d - 1))


def _steps(motion: JointMotion, now: Reference) -> Array:
    """Return the steps of speed where pieces begin, and at the end, (S + 1, N)."""
    c, T = motion.coefficients, motion.durations[:, None]
    before = sum(d * c[:, d] * T ** (d - 1) for d in range(1, 6))
    return np.asarray(np.abs(np.vstack([c[:, 1], 0.0 * now.v]) - np.vstack([now.v, before])))


def _runs(law: TargetPlanner, motion: JointMotion) -> list[tuple[int, int, JointCurve]]:
    """Return the stretches of a motion between steps of its speed: begin, end [ns], curve."""
    times = [*motion.starts_ns, motion.end_ns]
    steps = _steps(motion, Reference.at_rest(motion.coefficients[0, 0])) / law.limits.speed
    cut = [k for k in range(1, len(times) - 1) if steps[k].max() > _STEP]
    ends = [0, *cut, len(times) - 1]
    runs = []
    for first, last in itertools.pairwise(ends):
        begin, end = times[first], times[last]
        whole = (end - begin) * _SECONDS
        breaks = (np.array(times[first : last + 1]) - begin) / (end - begin)
        scaled = motion.coefficients[first:last] * whole ** np.arange(6)[:, None]
        runs.append((begin, end, JointCurve(breaks, scaled)))
    return runs


def _place(motion: JointMotion, piece: int) -> str:
    begins = [*motion.starts_ns, motion.end_ns][piece]
    return f"{(begins - motion.starts_ns[0]) * _SECONDS:.3g} s"
