"""The joints along a whole tool path, planned before it begins, or why there is no such way."""

import bisect
import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.ik.inverse_kinematics import InverseKinematics
from arm_emulator.motion.model.joint_reference import Reference, ReferenceMotion
from arm_emulator.motion.model.pose import Pose
from arm_emulator.motion.planner.candidate_paths import CandidatePaths
from arm_emulator.motion.planner.target_planner import TargetPlanner
from arm_emulator.motion.trajectory.joint_curve import ROUNDING, JointCurve
from arm_emulator.motion.trajectory.online_trajectory import Rest
from arm_emulator.motion.trajectory.timed_path import TimedPath, ToolPathLimits
from arm_emulator.motion.trajectory.tool_line import OFF_THE_LINE, measure_errors, trace_line
from arm_emulator.motion.trajectory.tool_path import WHERE, ToolPath

FEWEST_NODES = 32  # of a run between two stops
MAX_NODES = 40_000
LONGEST_TIME = 1e6  # s, of the whole path
_IN_AN_ARC = 8.0  # nodes
_FARTHEST_NODE = 5e-3  # m, or of the measure of a turn
_NODE_TIME = 5e-3  # s, between nodes of a path with times
_SETTLING_STEPS = 40  # of the joint goal
_SECONDS = 1e-9


class MotionSequence:
    """Motions one after the other, each beginning where the one before rests.

    Attributes:
        begins: of each motion, and the end of the last one (M + 1,) [s].
        duration: [s].
    """

    def __init__(self, motions: Sequence[ReferenceMotion]) -> None:
        self.motions = list(motions)
        self.begins = [0.0]
        for motion in self.motions:
            self.begins.append(self.begins[-1] + motion.duration)
        self.duration = self.begins[-1]

    def evaluate_at(self, time: float) -> Reference:
        """Return the joints at a time since the begin [s]."""
        k = min(max(0, bisect.bisect_right(self.begins, time) - 1), len(self.motions) - 1)
        return self.motions[k].evaluate_at(time - self.begins[k])


def plan_path(
    law: TargetPlanner, path: ToolPath, now: Reference, now_ns: int, scaled: bool
) -> MotionSequence:
    """Return the joints' motion to a path and along it.

    Raises:
        Refusal: some place of it cannot be reached, or not by its time.
    """
    stop = law.plan_stop(now)
    rest = stop.evaluate_at(stop.duration).q
    approach = _plan_approach(law, rest, path)
    start = approach.evaluate_at(approach.duration).q
    before: list[ReferenceMotion] = [stop, approach]
    arrival = stop.duration + approach.duration
    if path.times_ns is not None:
        first_time = (path.times_ns[0] - now_ns) * _SECONDS
        if arrival > first_time + 1e-9:
            rule = f"leave the tool {arrival:.3g} s to reach it"
            raise Refusal(WHERE, "the time of the first pose", rule, f"{first_time:.6g} s")
        before.append(Rest(start, max(0.0, first_time - arrival)))
        along = _plan_timed(law, path, start, scaled)
    else:
        along = _plan_runs(law, path, start)
    row = MotionSequence([*before, *along])
    if row.duration > LONGEST_TIME:
        value = f"{row.duration:.6g} s"
        raise Refusal(WHERE, "the path", f"take at most {LONGEST_TIME:g} s", value)
    return row


def _plan_approach(law: TargetPlanner, q: Array, path: ToolPath) -> ReferenceMotion:
    """Return the way from rest to the first pose, the best of `CandidatePaths`."""
    kinematics, to, limits = law.kinematics, path.first, path.limits
    R_WT, p_WT = kinematics.forward(q)
    begin = Pose(p_WT, R_WT if kinematics.has_orientation else to.R_WT)
    off = kinematics.tool_error(q, to) * kinematics.scale
    if float(np.linalg.norm(off)) < 1e-9:
        return Rest(q)
    line: JointCurve | str = (
        "" if kinematics.is_redundant else trace_line(law.arm, q, begin, to, None)
    )
    if isinstance(line, JointCurve):
        end = line.end
    else:
        goal = InverseKinematics(kinematics)
        goal.set_posture(law.posture)
        goal.set_target(to, q)
        goal.iterate_steps(_SETTLING_STEPS)
        if not goal.is_reached:
            error = goal.error[:3] / kinematics.scale[:3]
            value = f"one {np.linalg.norm(error):.3g} m beyond the nearest point"
            raise Refusal(WHERE, "poses[0]", "be where a way leads to", value)
        end = goal.q
        line = trace_line(law.arm, q, begin, to, end)
    turned = float(np.linalg.norm(off[3:])) if kinematics.has_orientation else 0.0
    length = max(float(np.linalg.norm(to.p_WT - p_WT)), limits.per_turn * turned)
    along = ToolPathLimits.limit_line(length, limits.speed, limits.acceleration, limits.jerk)
    candidates = CandidatePaths(law.arm, law.limits, q, to, along, heavy=False, where=WHERE)
    for candidate in candidates.generate_paths(end, line):
        return candidate.path
    raise candidates.refuse_overshoot(end)


def _plan_runs(law: TargetPlanner, path: ToolPath, start: Array) -> list[ReferenceMotion]:
    """Return a way for each run between stops."""
    curve, limits = path.curve, path.limits
    ends = [(float(a), float(b)) for a, b in zip(path.stops, path.stops[1:], strict=False)]
    if not ends:
        return [Rest(start)]
    nodes = [_place_nodes(path, a, b) for a, b in ends]
    q = _trace_joints(law, path, start, nodes)
    paths: list[ReferenceMotion] = []
    bend = curve.compute_curvature()
    first = 0
    for (a, b), x in zip(ends, nodes, strict=True):
        joints = JointCurve.fit_spline(q[first : first + len(x) + 1])
        _check_between(law, path, joints, lambda s, a=a, b=b: a + s * (b - a))
        first += len(x)
        inside = slice(
            int(np.searchsorted(curve.ends, a, side="right")),
            int(np.searchsorted(curve.ends, b, side="left")) + 1,
        )
        along = ToolPathLimits(
            b - a,
            limits.speed,
            limits.acceleration,
            limits.jerk,
            (curve.ends[inside] - a) / (b - a),
            bend[inside],
        )
        paths.append(TimedPath(joints, law.limits, law.arm, along, where=WHERE))
    return paths


def _place_nodes(path: ToolPath, a: float, b: float) -> Array:
    """Return evenly spread measures from one stop, without it, to the next (K,)."""
    curve = path.curve
    inside = (curve.ends > a) & (curve.ends - curve.length < b) & (curve.compute_curvature() > 0.0)
    farthest = _FARTHEST_NODE
    if inside.any():
        farthest = min(farthest, float(curve.length[inside].min()) / _IN_AN_ARC)
    count = min(max(FEWEST_NODES, math.ceil((b - a) / farthest)), MAX_NODES)
    return a + (b - a) * np.arange(1, count + 1) / count


def _plan_timed(
    law: TargetPlanner, path: ToolPath, start: Array, scaled: bool
) -> list[ReferenceMotion]:
    """Return the way of a path with times."""
    assert path.times_ns is not None
    curve = path.curve
    times = (np.array(path.times_ns) - path.times_ns[0]) * _SECONDS
    duration = float(times[-1])
    if len(curve) == 0:
        return [Rest(start, duration)]
    stops = np.isclose(curve.at_poses[:, None], path.stops, rtol=0.0, atol=1e-9).any(axis=1)
    distance = TimedDistance(times, curve.at_poses, stops)
    count = min(max(FEWEST_NODES, math.ceil(duration / _NODE_TIME)), MAX_NODES)

    def measure_distance(s: Array) -> Array:
        return distance.evaluate_at(s * duration)

    q = _trace_joints(law, path, start, [measure_distance(np.arange(1, count + 1) / count)])
    joints = JointCurve.fit_spline(q)
    _check_between(law, path, joints, measure_distance)
    exact = ConstantRateCurve(joints, duration)
    beyond = exact.find_excess(law)
    if not beyond:
        return [exact]
    if not scaled:
        j, share, s = beyond[:3]
        name = law.kinematics.joint_names[j]
        rule = f"keep the limits of {name}; with trajectory_limits: scale it takes longer"
        place = path.describe_place(float(measure_distance(np.array([s]))[0]))
        value = f"{share:.3g} times its {beyond[3]} {place}"
        raise Refusal(WHERE, "the path", rule, value)
    return [TimedPath(joints, law.limits, law.arm, requested=duration, where=WHERE)]


class ConstantRateCurve:
    """A curve of the joints at a constant rate."""

    def __init__(self, curve: JointCurve, duration: float) -> None:
        self.curve, self.duration = curve, duration

    def evaluate_at(self, time: float) -> Reference:
        """Return the joints at a time since the start [s]."""
        if time >= self.duration:
            return Reference.make_rest(self.curve.end)
        return Reference(
            *self.curve.derive_by_time(max(0.0, time) / self.duration, 1 / self.duration, 0, 0)
        )

    def find_excess(self, law: TargetPlanner) -> tuple[int, float, float, str] | None:
        """Return joint, ratio to the limit, place and limit of the largest excess."""
        s = np.linspace(0.0, 1.0, 4 * len(self.curve.breaks) + 1)
        derivatives = self.curve.compute_derivatives(s)
        worst = None
        for order, (limit, name) in enumerate(
            ((law.limits.speed, "speed"), (law.limits.acceleration, "acceleration")), start=1
        ):
            share = np.abs(derivatives[order]) / (limit * self.duration**order)
            k, j = np.unravel_index(int(np.argmax(share)), share.shape)
            largest = float(share[k, j])
            if largest > 1.0 + 1e-6 and (worst is None or largest > worst[1]):
                worst = int(j), largest, float(s[k]), name
        return worst


def _trace_joints(
    law: TargetPlanner, path: ToolPath, start: Array, nodes: Sequence[Array]
) -> Array:
    """Return the joints at measures of a path (1 + K, N)."""
    x = np.concatenate(nodes)
    poses, arm, kinematics = path.curve.draw_poses(x), law.arm, law.kinematics
    low = np.minimum(kinematics.lower, start) - ROUNDING
    high = np.maximum(kinematics.upper, start) + ROUNDING
    q = arm.trace_poses(start, poses.p, poses.R)
    if len(q) == len(x) + 1 and kinematics.is_redundant:
        goal = InverseKinematics(kinematics)  # redundant joints end where they began after a cycle
        goal.set_posture(law.posture)
        goal.set_target(Pose(poses.p[-1], poses.R[-1]), q[-1])
        goal.iterate_steps(_SETTLING_STEPS)
        if goal.is_reached:
            again = arm.trace_poses(start, poses.p, poses.R, goal.q)
            inside = (again >= low) & (again <= high)
            q = again if len(again) == len(q) and inside.all() else q
    if len(q) <= len(x):
        rule = "be where the arm can follow"
        raise Refusal(
            WHERE, "the path", rule, f"a place beyond, {path.describe_place(x[len(q) - 1])}"
        )
    return q


def _check_between(law: TargetPlanner, path: ToolPath, joints: JointCurve, measure) -> None:  # type: ignore[no-untyped-def]
    """Refuse a spline that leaves limits of position, or the path: the arm would flip there."""
    kinematics = law.kinematics
    beyond = joints.find_exit(kinematics.lower, kinematics.upper)
    if beyond is not None:
        place, j, angle = beyond
        name = kinematics.joint_names[j]
        rule = f"keep {name} within [{kinematics.lower[j]:.4g}, {kinematics.upper[j]:.4g}]"
        value = f"{angle:.6g} {path.describe_place(float(measure(np.array([place]))[0]))}"
        raise Refusal(WHERE, "the path", rule, value)
    breaks = joints.breaks
    s = 0.5 * (breaks[1:] + breaks[:-1])
    x = measure(s)
    off = measure_errors(law.arm, joints.compute_derivatives(s)[0], path.curve.draw_poses(x))
    k = int(np.argmax(off))
    if off[k] > OFF_THE_PATH:
        rule = "be where the joints can follow without a jump"
        raise Refusal(
            WHERE, "the path", rule, f"a singular pose {path.describe_place(float(x[k]))}"
        )


OFF_THE_PATH = 20.0 * OFF_THE_LINE  # rad, or m per reach: where the curvature steps


class TimedDistance:
    """Distance over time: quintics between the places, without acceleration in them.

    Slopes as of Fritsch and Butland (1984), so that it never goes back; 0 at both ends and where
    asked for.

    Args:
        times: ascending (K,) [s].
        distance: never falling (K,) [m].
        stops: whether it rests in each place (K,).
    """

    def __init__(self, times: Array, distance: Array, stops: npt.NDArray[np.bool_]) -> None:
        self._t, self._s = times, distance
        h = np.diff(times)
        m = np.diff(distance) / h
        self._v = np.zeros_like(distance)
        with np.errstate(divide="ignore"):
            early, late = 2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]
            self._v[1:-1] = (early + late) / (early / m[:-1] + late / m[1:])
        self._v[stops] = 0.0

    def evaluate_at(self, t: Array) -> Array:
        """Return the distances at times (P,) [s]."""
        i = np.clip(np.searchsorted(self._t, t, side="right") - 1, 0, len(self._t) - 2)
        h = self._t[i + 1] - self._t[i]
        u = np.clip((t - self._t[i]) / h, 0.0, 1.0)
        v0, v1, d = h * self._v[i], h * self._v[i + 1], self._s[i + 1] - self._s[i]
        third = 10.0 * d - 6.0 * v0 - 4.0 * v1
        fourth = -15.0 * d + 8.0 * v0 + 7.0 * v1
        fifth = 6.0 * d - 3.0 * (v0 + v1)
        return np.asarray(self._s[i] + u * (v0 + u * u * (third + u * (fourth + u * fifth))))
