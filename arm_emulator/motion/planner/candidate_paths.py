"""Ways from rest to a target, the best first.

The tool's line; the same, turning the other way round or as the joints do; an arc of the joints
where the tool would go past its end on their line; their line.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import ruckig

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.ik.configuration_search import generate_low_discrepancy
from arm_emulator.motion.model.arm_tree import ArmTree
from arm_emulator.motion.model.joint_reference import Overshoot
from arm_emulator.motion.model.kinematics import POSITION_ROWS
from arm_emulator.motion.model.pose import Pose
from arm_emulator.motion.trajectory.jerk_limited_velocity import solve_with_ruckig
from arm_emulator.motion.trajectory.joint_curve import JointCurve
from arm_emulator.motion.trajectory.timed_path import JointPathLimits, TimedPath, ToolPathLimits
from arm_emulator.motion.trajectory.tool_line import trace_line

MUCH_LONGER = 1.5  # times the joints' line takes, and
LONGER = 0.1  # s: then the joints' line is taken
FARTHEST_PAST = 3e-3  # m past its end, that a way may take the tool
MIN_TURN = 0.5 * math.pi  # rad, whose other way round may be gone


@dataclass(frozen=True, eq=False)
class CandidatePath:
    """A way to a target."""

    path: TimedPath
    words: str
    """Kind and reason, as text."""
    end: Array
    """Joint angles where it ends (N,)."""


class CandidatePaths:
    """Ways of an arm within limits.

    Args:
        arm: the arm.
        limits: of its joints.
        start: its joints at rest (N,).
        target: pose of the tool.
        along: limits of the tool along its line; None: it is as fast as the joints.
        heavy: whether ways that need more torque than the limits are gone, with a notice.
        where: names the motion in refusals.

    Attributes:
        notices: limits that no way keeps, as text.
    """

    def __init__(
        self,
        arm: ArmTree,
        limits: JointPathLimits,
        start: Array,
        target: Pose,
        along: ToolPathLimits | None = None,
        heavy: bool = True,
        where: str = "motion",
    ) -> None:
        self._arm, self._limits, self._start, self._target = arm, limits, start, target
        self._along, self._heavy, self._where = along, heavy, where
        R_WT, p_WT = arm.kinematics.forward(start)
        self._begin = Pose.computed(p_WT, R_WT)
        self.notices: list[str] = []

    def generate_paths(self, end: Array, line: JointCurve | str) -> Iterator[CandidatePath]:
        """Yield the ways to joint angles (N,) that reach the target.

        Args:
            end: the angles.
            line: the joints along the tool's line; or why there is no such curve.

        Raises:
            Refusal: a way needs more torque than the limits, and is not gone.
        """
        along = JointCurve.make_line(self._start, end)
        joints: TimedPath | None = None
        slow, reverse_last = None, True
        if isinstance(line, JointCurve):
            straight = self._schedule_curve(line)
            longest = (
                MUCH_LONGER * compute_joints_duration(end - self._start, self._limits) + LONGER
            )
            if straight.duration > longest:
                joints = self._schedule_curve(along)
                longest = MUCH_LONGER * joints.duration + LONGER
            if straight.duration <= longest:
                yield CandidatePath(self._limit_tool(straight), "along the tool's line", end)
                line = "parts would touch on the tool's"
                yield from self._reverse_turn(line)
                reverse_last = False
            else:
                assert joints is not None
                slow = straight
                line = (
                    "the tool's passes near a singular pose and would take "
                    f"{straight.duration:.3g} s instead of {joints.duration:.3g} s"
                )
        joints = joints or self._schedule_curve(along)
        free = self._follow_joints(end)
        if isinstance(free, JointCurve):
            straight = self._schedule_curve(free)
            if straight.duration <= MUCH_LONGER * joints.duration + LONGER:
                words = f"along the tool's line, turning as the joints do: {line}"
                yield CandidatePath(self._limit_tool(straight), words, end)
        past = measure_overshoot(self._arm, along)
        if past > QUIETLY_PAST:
            line = f"{line}; on the joints' line the tool goes {past * 1e3:.3g} mm past its end"
            arc = find_joint_arc(self._arm, self._start, end)
            if arc is not None:
                yield CandidatePath(
                    self._schedule_curve(arc), f"along an arc of the joints: {line}", end
                )
        if past <= FARTHEST_PAST:
            yield CandidatePath(joints, f"along the joints' line: {line}", end)
        if slow is not None:
            words = "along the tool's line, slowly: no other way is free"
            yield CandidatePath(self._limit_tool(slow), words, end)
        if reverse_last:
            yield from self._reverse_turn("no other way is free")

    def refuse_overshoot(self, end: Array) -> Overshoot:
        """Return the refusal of joint angles (N,) to which no way leads."""
        past = measure_overshoot(self._arm, JointCurve.make_line(self._start, end)) * 1e3
        rule = f"take the tool at most {FARTHEST_PAST * 1e3:g} mm past its end"
        valid = "a target on the way, or a joint trajectory"
        return Overshoot(
            self._where, "the way", rule, f"{past:.3g} mm on all that were found", valid
        )

    def _reverse_turn(self, why: str) -> Iterator[CandidatePath]:
        """Yield the tool's line, turning the other way round, if that exists."""
        kinematics = self._arm.kinematics
        turn = kinematics.tool_error(self._start, self._target)[POSITION_ROWS:]
        if np.linalg.norm(turn) < MIN_TURN:
            return
        ends = self._begin, self._target
        curve = trace_line(self._arm, self._start, *ends, None, long_rotation=True)
        if isinstance(curve, JointCurve):
            words = f"along the tool's line, turning the other way round: {why}"
            yield CandidatePath(self._limit_tool(self._schedule_curve(curve)), words, curve.end)

    def _follow_joints(self, end: Array) -> JointCurve | str:
        """Return the joints' curve to their angles at the end on which the tool goes straight."""
        if self._arm.kinematics.to_tool.sum() <= POSITION_ROWS:
            return "the tool's place alone determines the joints"
        p, R = self._arm.compute_tool_poses(np.stack([self._start, end]))
        begin, to = (Pose.computed(p[k], R[k]) for k in range(2))
        return trace_line(self._arm, self._start, begin, to, end, False)

    def _limit_tool(self, path: TimedPath) -> TimedPath:
        """Return a way along the tool's line within the limits of the tool."""
        return path if self._along is None else self._schedule_curve(path.curve, self._along)

    def _schedule_curve(self, curve: JointCurve, along: ToolPathLimits | None = None) -> TimedPath:
        try:
            return TimedPath(curve, self._limits, self._arm, along, where=self._where)
        except Refusal as reason:  # the arm exceeds the torques of its description there
            if not self._heavy:
                raise
            self.notices.append(str(reason))
            return TimedPath(curve, self._limits, along=along)


def compute_joints_duration(step: Array, limits: JointPathLimits) -> float:
    """Return the duration of a line of the joints without torque limits [s]."""
    size = np.maximum(np.abs(step), 1e-12)
    problem, trajectory = ruckig.InputParameter(1), ruckig.Trajectory(1)
    problem.target_position = [1.0]
    problem.max_velocity = [float((limits.speed / size).min())]
    problem.max_acceleration = [float((limits.acceleration / size).min())]
    problem.max_jerk = [float((limits.jerk / size).min())]
    try:
        solve_with_ruckig(lambda: ruckig.Ruckig(1).calculate(problem, trajectory))
    except ArithmeticError:  # numbers beyond its range: no step
        return 0.0
    return float(trajectory.duration)


# On the joints' line the tool may go past the place where it comes to rest, and come back. An arc
# of the joints next to that line comes to the same end from before it.
QUIETLY_PAST = 1e-3  # m past its end, that a curve of the joints may take the tool without a word
_TRIED = ((1, 256), (2, 512))  # control points between the ends, and sets of them
_TOGETHER = 64  # sets
_ASIDE = 2.0  # rad (or m per reach) that they lie beyond both ends at most
_LOOKS, _LOOKS_AGAIN = np.linspace(0.0, 1.0, 33), np.linspace(0.0, 1.0, 257)
# From control points of Bezier's curves to coefficients of powers.
_POWERS = {
    1: np.array([[1.0, 0.0, 0.0], [-2.0, 2.0, 0.0], [1.0, -2.0, 1.0]]),
    2: np.array(
        [[1.0, 0.0, 0.0, 0.0], [-3.0, 3.0, 0.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1.0, 3.0, -3.0, 1.0]]
    ),
}


def measure_overshoot(arm: ArmTree, curve: JointCurve) -> float:
    """Return how far the tool goes past its end, along the line to it, on a curve [m].

    A tool that comes to rest where it began has no such line: 0.
    """
    return float(_measure_past(arm, curve.compute_derivatives(_LOOKS_AGAIN)[0][None])[0])


def find_joint_arc(arm: ArmTree, start: Array, end: Array) -> JointCurve | None:
    """Return a curve on which the tool goes `QUIETLY_PAST` its end at most; None: none was found.

    Bezier's curves with control points all over the limits, those nearest to the joints' line
    first: they lie within the limits, as their control points do.
    """
    kinematics = arm.kinematics
    low, high = np.minimum(start, end), np.maximum(start, end)
    aside = _ASIDE * kinematics.joint_scale
    low = np.maximum(np.minimum(kinematics.lower, low), low - aside)
    high = np.minimum(np.maximum(kinematics.upper, high), high + aside)
    for between, count in _TRIED:
        parts = generate_low_discrepancy(count, between * len(start)).reshape(count, between, -1)
        share = np.arange(1.0, between + 1.0)[:, None] / (between + 1)
        line = start + share * (end - start)
        points = np.where(kinematics.to_tool, low + parts * (high - low), line)
        far = np.square((points - line) / kinematics.joint_scale).sum(axis=(1, 2))
        points = points[np.argsort(far, kind="stable")]
        for first in range(0, count, _TOGETHER):
            some = points[first : first + _TOGETHER]
            ends = [np.broadcast_to(q, (len(some), 1, len(q))) for q in (start, end)]
            coefficients = _POWERS[between] @ np.concatenate([ends[0], some, ends[1]], axis=1)
            powers = np.vander(_LOOKS, between + 2, increasing=True)
            for k in np.flatnonzero(_measure_past(arm, powers @ coefficients) <= QUIETLY_PAST):
                curve = JointCurve(np.array([0.0, 1.0]), coefficients[k][None])
                if measure_overshoot(arm, curve) <= QUIETLY_PAST:
                    return curve
    return None


def _measure_past(arm: ArmTree, q: Array) -> Array:
    """Return how far the tool goes past its end on curves (K, looks, N), (K,) [m]."""
    p = arm.compute_tool_poses(q.reshape(-1, q.shape[-1]))[0].reshape(*q.shape[:2], 3)
    line = p[:, -1] - p[:, 0]
    length = np.sqrt(np.einsum("ki,ki->k", line, line))
    along = np.einsum("kli,ki->kl", p - p[:, -1:], line).max(axis=1)
    return np.asarray(np.where(length > QUIETLY_PAST, along / np.maximum(length, 1e-9), 0.0))
