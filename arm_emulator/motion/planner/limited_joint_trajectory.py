"""Joint trajectories within the limits of speed and acceleration: as they are, slower, or refused.

A trajectory whose speeds step, as those of points without speeds do, comes to rest where they step.
"""

import itertools
from typing import Protocol

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.model.joint_reference import Reference, ReferenceMotion
from arm_emulator.motion.planner.target_planner import TargetPlanner
from arm_emulator.motion.planner.tool_path_planner import MotionSequence
from arm_emulator.motion.trajectory.joint_curve import JointCurve
from arm_emulator.motion.trajectory.joint_trajectory import WHERE, JointMotion, JointTrajectory
from arm_emulator.motion.trajectory.time_scaling import Resumed
from arm_emulator.motion.trajectory.timed_path import JointPathLimits, TimedPath

# A planner's points keep the limits; a spline through them exceeds them a little here and there.
BETWEEN_POINTS = 1.05
_STEP = 1e-3  # of the speed limit: rounding of planners changes speeds by less
_LOOKS = np.linspace(0.0, 1.0, 9)  # places of a piece at which it is held against the limits
_SECONDS = 1e-9


class TimedMotion(ReferenceMotion, Protocol):
    """A joint trajectory from its begin on; `JointMotion` keeps the times that were asked for.

    Attributes:
        path_text: why it takes longer, in words; empty: it does not.
    """

    path_text: str

    def find_requested_ns(self, time: float) -> int:
        """Return the requested time of what holds at a time [s], both since the begin [ns]."""


class StretchedTrajectory(MotionSequence):
    """A joint trajectory that takes longer than asked.

    Args:
        before: how the joints come to rest.
        runs: between stops: begin and end as asked, since the begin [ns], and motion.
        path_text: why it takes longer, in words.
    """

    def __init__(
        self, before: ReferenceMotion, runs: list[tuple[int, int, TimedPath]], path_text: str
    ) -> None:
        super().__init__([before, *(run for _, _, run in runs)])
        self._runs, self.path_text = runs, path_text
        self.duration = round(self.duration / _SECONDS) * _SECONDS

    def evaluate_at(self, time: float) -> Reference:
        """See `ReferenceMotion`; at whole nanoseconds, as all times of trajectories."""
        return super().evaluate_at(round(time / _SECONDS) * _SECONDS)

    def find_requested_ns(self, time: float) -> int:
        """See `TimedMotion`."""
        for (begin, end, run), since in zip(self._runs, self.begins[1:], strict=False):
            if time < since + run.duration:
                return begin + round(run.compute_distance(time - since) * (end - begin))
        return self._runs[-1][1]


class DelayedTrajectory(Resumed):
    """A joint trajectory that continues after a standstill; arguments as those of `Resumed`."""

    def __init__(
        self, before: TimedMotion, since: float, now: Reference, limits: JointPathLimits
    ) -> None:
        super().__init__(before, since, now, limits)
        self._before = before

    def find_requested_ns(self, time: float) -> int:
        """See `TimedMotion`."""
        return self._before.find_requested_ns(self.map_time(time))


def fit_trajectory(
    law: TargetPlanner,
    trajectory: JointTrajectory,
    now_ns: int,
    start_ns: int,
    now: Reference,
    scaled: bool,
) -> JointMotion | StretchedTrajectory:
    """Return the motion of a trajectory.

    Raises:
        Refusal: it cannot be begun so, or is faster than the limits and must not be scaled.
    """
    motion = trajectory.begin_motion(now_ns, start_ns, now)
    beyond = "" if trajectory.is_stop else find_excess(law, motion, now)
    if not beyond:
        return motion
    if not scaled:
        rule = "keep the limits (trajectory_limits: scale makes it slower)"
        raise Refusal(WHERE, "the points", rule, beyond)
    stop = law.plan_stop(now)
    still = Reference.make_rest(stop.evaluate_at(stop.duration).q)
    motion = trajectory.begin_motion(now_ns, start_ns, still)
    runs = [
        (
            begin,
            end,
            TimedPath(curve, law.limits, law.arm, requested=(end - begin) * _SECONDS, where=WHERE),
        )
        for begin, end, curve in _split_runs(law, motion)
    ]
    takes = stop.duration + sum(run.duration for _, _, run in runs)
    path_text = f"in {takes:.3g} s instead of {motion.duration:.3g} s: {beyond}"
    return StretchedTrajectory(stop, runs, path_text)


def find_excess(law: TargetPlanner, motion: JointMotion, now: Reference) -> str:
    """Return the limit that a motion exceeds most, with place and ratio; empty: none."""
    c, T = motion.coefficients, motion.durations[:, None, None]
    limits, names = law.limits, law.kinematics.joint_names
    top = law.top_speed
    worst, words = BETWEEN_POINTS, ""
    steps = _find_steps(motion, now) / limits.speed
    k, j = np.unravel_index(int(np.argmax(steps)), steps.shape)
    if steps[k, j] > _STEP:
        v = steps[k, j] * limits.speed[j]
        return f"the speed of {names[j]} steps by {v:.3g} rad/s at {_name_place(motion, int(k))}"
    t = T[:, :, 0] * _LOOKS  # (S, looks)
    for order, limit, unit in ((1, top, "rad/s"), (2, limits.acceleration, "rad/s2")):
        powers = np.stack(
            [_compute_factor(d, order) * t ** max(0, d - order) for d in range(6)], axis=2
        )
        share = np.abs(powers @ c) / limit
        k, look, j = np.unravel_index(int(np.argmax(share)), share.shape)
        if share[k, look, j] > worst:
            worst = float(share[k, look, j])
            words = f"{names[j]} at {worst * limit[j]:.3g} {unit} after "
            words += _name_place(motion, int(k))
            words += f", its limit is {limit[j]:.3g}"
    return words


def _compute_factor(d: int, order: int) -> float:
    return float(d if order == 1 else d * (d - 1))


def _find_steps(motion: JointMotion, now: Reference) -> Array:
    """Return the steps of speed where pieces begin, and at the end, (S + 1, N)."""
    c, T = motion.coefficients, motion.durations[:, None]
    before = sum(d * c[:, d] * T ** (d - 1) for d in range(1, 6))
    return np.asarray(np.abs(np.vstack([c[:, 1], 0.0 * now.v]) - np.vstack([now.v, before])))


def _split_runs(law: TargetPlanner, motion: JointMotion) -> list[tuple[int, int, JointCurve]]:
    """Return the stretches of a motion between steps of its speed: begin, end [ns], curve."""
    times = [*motion.starts_ns, motion.end_ns]
    steps = _find_steps(motion, Reference.make_rest(motion.coefficients[0, 0])) / law.limits.speed
    cut = [k for k in range(1, len(times) - 1) if steps[k].max() > _STEP]
    ends = [0, *cut, len(times) - 1]
    runs = []
    for first, last in itertools.pairwise(ends):
        begin, end = times[first], times[last]
        seconds = (end - begin) * _SECONDS
        breaks = (np.array(times[first : last + 1]) - begin) / (end - begin)
        scaled = motion.coefficients[first:last] * seconds ** np.arange(6)[:, None]
        runs.append((begin, end, JointCurve(breaks, scaled)))
    return runs


def _name_place(motion: JointMotion, piece: int) -> str:
    begins = [*motion.starts_ns, motion.end_ns][piece]
    return f"{begins * _SECONDS:.3g} s"
