"""Tool targets along planned ways.

A target that comes while the arm rests is reached along the tool's line. If that line is not
possible or takes much longer, the joints' line replaces it. Where the tool would pass its end on
the joints' line, an arc of the joints beside it replaces that line. A target that comes while the
arm moves is reached from that motion, jerk-limited (`OnlineTrajectory`). All ways are planned to
their end within the limits of speed, acceleration and jerk. Ways from rest keep the torques of the
description, too. No way therefore passes its end.

The reference is the controller's own. It begins at rest at the arm's position and never depends on
a later measurement. The limits therefore hold by construction, whatever the servo does, and
measurement noise does not come back as motion.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.coerce import coerce_kind
from arm_emulator.motion.ik.configuration_search import ConfigurationSearch
from arm_emulator.motion.ik.inverse_kinematics import InverseKinematics
from arm_emulator.motion.model.arm_tree import ArmTree
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.joint_reference import (
    JointSetpoint,
    Overshoot,
    PlanningError,
    Reference,
    ReferenceMotion,
)
from arm_emulator.motion.model.kinematics import POSITION_ROWS, Kinematics
from arm_emulator.motion.model.pose import Pose
from arm_emulator.motion.planner.candidate_paths import CandidatePaths
from arm_emulator.motion.planner.collision_guard import CollisionGuard
from arm_emulator.motion.trajectory.joint_curve import JointCurve
from arm_emulator.motion.trajectory.online_trajectory import OnlineTrajectory, Rest
from arm_emulator.motion.trajectory.timed_path import JointPathLimits, TimedPath
from arm_emulator.motion.trajectory.tool_line import trace_line

LOST = 0.2  # rad (or m per reach) between arm and reference: something else moves the arm
# Shares of the description's limits; the rest is for links that swing on their gears.
SPEED_SHARE, ACCELERATION_SHARE = 0.89, 0.72
JERK_TIME = 0.05  # s in which the acceleration comes to its limit, where no jerk is given
# Periods that this takes at least: the servo knows a change of the acceleration a period late, and
# the links swing by what has changed meanwhile.
JERK_PERIODS = 7
_STEPS = 6  # of the joint goal per motion period
_LONGEST_SEEK = 20  # periods, for which the arm waits
_FAR, _NEARER = 1.0, 0.8  # rad, and parts of it: then nearer joint angles are looked for
_FAR_STEPS = 30  # of the joint goal, for them
_LONGEST_SEARCH = 0.7  # s, for which the arm waits until a target is taken as beyond reach
_SEARCH_TIME = 0.5e-3  # s of logical time for a step of the search
BEYOND_REACH = "the target is beyond reach"  # as far as is known
WHERE = "tool_target"
_STILL = 1e-9  # rad/s, rad/s2 and per reach
_SAME = 1e-9  # m, and of a rotation's entries: the same target once more


class TargetPlanner:
    """Tool targets to joint targets with their derivatives.

    Args:
        kinematics: of the arm, with its limits.
        config: parameters.
    """

    def __init__(self, kinematics: Kinematics, config: MotionConfig) -> None:
        self.kinematics = kinematics
        self.period = config.period
        self.arm = ArmTree(kinematics, (config.gravity_x, config.gravity_y, config.gravity_z))
        self._set_limits(config)
        self._goal = InverseKinematics(kinematics)
        self._elsewhere = ConfigurationSearch(kinematics)
        self.error = np.full(kinematics.rows, math.nan)
        """Tool error that the last answer found, (rows,) [m, rad]; NaN before any."""
        self.notices: tuple[str, ...] = ()
        """Limit of the last answer, as text; empty: none."""
        self.path_text = ""
        """Kind of the way to the target and the reason, as text; empty: unknown yet."""
        self.guard: CollisionGuard | None = None
        """Checks motions before they begin; None: nobody does."""
        self._began = False
        self._target: Pose | None
        self._forget_motion()
        self._motion: ReferenceMotion
        self._coming: Reference | None = None  # `coming`, once it was asked for
        self._time = 0.0
        self._take_over(Reference.make_rest(np.zeros(len(kinematics.joint_names))))

    def retune(self, config: MotionConfig) -> None:
        """Continue with other limits, from the next path on.

        Raises:
            Refusal: config is not a MotionConfig.
        """
        coerce_kind(config, MotionConfig, "TargetPlanner.retune", "config", "be a MotionConfig")
        self._set_limits(config)

    def begin(self, q: npt.ArrayLike, v: npt.ArrayLike | None = None) -> None:
        """Begin at joint angles q (N,), which redundant arms come back to.

        Args:
            q: [rad or m].
            v: joint speeds (N,) [rad/s or m/s]; None: at rest.
        """
        here = Reference.make_rest(self.kinematics.vector(q).copy())
        if v is not None:
            here = replace(here, v=self.kinematics.vector(v).copy())
        self.begin_moving(here)

    def begin_moving(self, now: Reference) -> None:
        """Begin with the joints' motion."""
        self._began = True
        self._take_over(now)

    @property
    def coming(self) -> Reference:
        """Commanded motion of the joints at the next motion period."""
        if self._coming is None:
            self._coming = self._motion.evaluate_at(self._time)
        return self._coming

    @property
    def motion(self) -> ReferenceMotion:
        """Present motion of the reference."""
        return self._motion

    @property
    def elapsed(self) -> float:
        """Time of the reference within its motion [s]."""
        return self._time

    @property
    def posture(self) -> Array:
        """The joint angles that redundant arms come back to (N,)."""
        return self._goal.posture

    @property
    def is_searching(self) -> bool:
        """Whether it still looks for joint angles that reach the target."""
        return self._seeking > 0 or (self._looking and not self._elsewhere.is_over)

    def update(self, q: npt.ArrayLike, target: Pose) -> JointSetpoint:
        """Return the joint targets that bring the tool nearer to its target, and hold it there.

        Args:
            q: measured joint angles (N,) [rad or m].
            target: where the tool shall be.

        Raises:
            Refusal: q of a wrong length, not finite or too large. Nothing has changed then.
            PlanningError: parts would touch on the way, or the tool would go far past its end.
            ArithmeticError: the robot description holds numbers that cannot be computed with.
        """
        q = self.kinematics.vector(q)
        coerce_kind(target, Pose, "TargetPlanner.update", "target", "be a Pose")
        notices = self._find_reference(q)
        now = self.coming
        if target is not self._target and not _is_same(target, self._target):
            self._plan_to(target, now)
        self._target = target
        try:
            self._find_path(now, notices)
        except PlanningError:
            self._forget_motion()  # the same target is a new one
            raise
        if not self._seeking and not self._goal.is_reached:
            notices.append(self._describe_unreachable())
        self.notices = tuple(notices)
        return self.go_on(q, target)

    def _find_path(self, now: Reference, notices: list[str]) -> None:
        """Search the joint angles of the target, and set out."""
        if self._seeking:
            self._iterate_ik(now, notices)
        elif self._past_end is not None or (
            not self._goal.is_reached and (self._goal.settled or self._looking)
        ):
            self._search_configurations(now, notices)

    def follow(self, motion: ReferenceMotion, path_text: str) -> None:
        """Follow a motion that begins with the joints' commanded motion, from now on."""
        self._forget_motion()
        self._begin_motion(motion, path_text)

    def go_on(self, q: Array, end: Pose) -> JointSetpoint:
        """Return the present joint targets, and advance along the motion."""
        now = self.coming
        self._time, self._coming = self._time + self.period, None
        v = (self.coming.q - now.q) / self.period
        if not np.isfinite(v).all():
            raise ArithmeticError(f"the joint speeds are not finite at q = {q}")
        self.error = self.kinematics.tool_error(q, end)
        return JointSetpoint(now.q, v, None, now, self.coming)

    @property
    def is_resting(self) -> bool:
        """Whether the reference is at the end of its last way."""
        return self._time > self._motion.duration and not self.is_searching

    def _set_limits(self, config: MotionConfig) -> None:
        self.limits = make_joint_path_limits(self.kinematics, config)
        self.top_speed = np.minimum(self.kinematics.velocity_limit, config.velocity_limit)
        """Bounds of requested speeds (N,): without the reserve for swinging links."""

    def _take_over(self, now: Reference) -> None:
        """Set the reference to the joints' motion, and bring it to rest."""
        self._goal.set_posture(now.q)
        self._forget_motion()
        self._begin_motion(self.plan_stop(now), "")

    def _forget_motion(self) -> None:
        self._target = None
        self._seeking, self._looking, self._waits = 0, False, 0
        self._past_end: Overshoot | None = None  # why the way to the first joint angles is not gone

    def _begin_motion(self, motion: ReferenceMotion, path_text: str) -> None:
        self._motion, self._time, self._coming, self.path_text = motion, 0.0, None, path_text

    def plan_stop(self, now: Reference) -> ReferenceMotion:
        """Return the joints' motion to rest."""
        if self._is_still(now):
            return Rest(now.q)
        kinematics = self.kinematics
        return OnlineTrajectory(now, None, self.limits, kinematics.lower, kinematics.upper)

    def _is_still(self, now: Reference) -> bool:
        scale = self.kinematics.joint_scale
        return bool((np.abs(now.v) <= _STILL * scale).all() and (np.abs(now.a) <= _STILL).all())

    def _find_reference(self, q: Array) -> list[str]:
        """Restart at the arm's position if it is far from the reference; report it."""
        notices = []
        if not self._began:
            self.begin(q)
        off = float(np.abs((q - self.coming.q) / self.kinematics.joint_scale).max())
        if off > LOST:
            self.begin(q)
            notices.append(f"the arm was {off:.2g} rad from its reference, which began anew there")
        return notices

    def _plan_to(self, target: Pose, now: Reference) -> None:
        self._goal.set_target(target, now.q)
        if not self._is_still(now) and not self.kinematics.to_tool.all():
            stop = self.plan_stop(now)
            self._goal.hold_joints(stop.evaluate_at(stop.duration).q)
        self._looking, self._waits, self._past_end = False, 0, None
        self._seeking = 1
        self._followed: JointCurve | str = ""
        if self._is_still(now) and not self.kinematics.is_redundant:
            # The tool's line leads to the only joint angles that continue those of now.
            self._followed = self._follow_line(now, target, None)
            if isinstance(self._followed, JointCurve):
                self._accept_line_end(self._followed.end, now)

    def _accept_line_end(self, end: Array, now: Reference) -> None:
        """Take the joint angles that the tool's line leads to, unless there are nearer ones.

        A line close by a singular pose may turn the wrist over.
        """
        scale = self.kinematics.joint_scale
        far = float(np.abs((end - now.q) / scale).max())
        if far > _FAR:
            self._goal.iterate_steps(_FAR_STEPS)
            distance = float(np.abs((self._goal.q - now.q) / scale).max())
            if self._goal.is_reached and distance < _NEARER * far:
                self._followed = "the tool's leads to joint angles that are farther away"
                return
        self._goal.take_angles(end)

    def _iterate_ik(self, now: Reference, notices: list[str]) -> None:
        """Search the joint angles of the target, and move there."""
        assert self._target is not None
        goal = self._goal
        goal.iterate_steps(_STEPS)
        still = self._is_still(now)
        self._seeking = 0 if goal.settled else self._seeking + 1
        if still and 0 < self._seeking < _LONGEST_SEEK:  # until it knows the end of its way
            return
        if not still:
            self._plan_from_motion(now)
            return
        line = self._followed
        if goal.is_reached and not isinstance(line, JointCurve):
            if self.kinematics.is_redundant:
                line = self._follow_line(now, self._target, goal.q)
        if goal.is_reached:
            try:
                self._start_motion(now, line, notices)
            except Overshoot as reason:
                self._past_end = reason
                self._start_search(now)
        elif goal.settled or self._seeking == _LONGEST_SEEK:
            # Another configuration may reach it, and is better taken from here.
            self._seeking = 0
            self._start_search(now)
            self._waits = math.ceil(_LONGEST_SEARCH / self.period)
        else:
            self._start_motion(now, BEYOND_REACH, notices)

    def _follow_line(self, now: Reference, target: Pose, goal: Array | None) -> JointCurve | str:
        R_WT, p_WT = self.kinematics.forward(now.q)
        return trace_line(self.arm, now.q, Pose.computed(p_WT, R_WT), target, goal)

    def _plan_from_motion(self, now: Reference) -> None:
        """Go to the joint goal from a motion."""
        kinematics = self.kinematics
        motion = OnlineTrajectory(
            now, self._goal.q, self.limits, kinematics.lower, kinematics.upper
        )
        self._check_motion(motion)
        self._begin_motion(
            motion, "from its motion along a way of the joints: the target came on the way"
        )
        if motion.stops:  # from rest it goes on
            self._seeking = max(1, self._seeking)

    def _start_motion(self, now: Reference, line: JointCurve | str, notices: list[str]) -> None:
        """Go to the joint goal from rest, along the tool's line or the reason why not."""
        assert self._target is not None
        refused: PlanningError | None = None
        candidates = CandidatePaths(self.arm, self.limits, now.q, self._target, where=WHERE)
        end = self._goal.q
        for candidate in candidates.generate_paths(end, line):
            if refused is not None and candidate.end is end and self._is_touching(end):
                continue  # wherever it comes from
            try:
                self._check_motion(candidate.path)
            except PlanningError as reason:
                refused = refused or reason
                continue
            notices += candidates.notices
            if candidate.end is not end:
                self._goal.take_angles(candidate.end)
            self._begin_motion(candidate.path, candidate.words)
            return
        if refused is not None:
            raise refused
        raise candidates.refuse_overshoot(end)

    def _is_touching(self, q: Array) -> bool:
        return self.guard is not None and bool(self.guard.collisions.find_first_contact(q))

    def _check_motion(self, motion: ReferenceMotion) -> None:
        if self.guard is not None:
            self.guard.check_motion(WHERE, sample_angles(motion))

    def _search_configurations(self, now: Reference, notices: list[str]) -> None:
        """Search for a configuration that reaches; while it takes long, at the nearest point."""
        if not self._looking:
            if self._time > self._motion.duration:
                self._start_search(now)
            return
        # As many per time whatever the period: all are tried within 0.7 s.
        angles = self._elsewhere.search_steps(max(3, round(self.period / _SEARCH_TIME)))
        self._waits -= 1
        if angles is not None:
            self._goal.take_angles(angles)
            try:
                self._start_motion(now, "another configuration reaches the target", notices)
            except Overshoot as reason:
                self._past_end = self._past_end or reason
            else:
                self._looking, self._past_end = False, None
        elif self._past_end is not None and self._elsewhere.is_over:
            raise self._past_end
        elif self._past_end is None and (
            self._waits == 0 or (self._waits > 0 and self._elsewhere.is_over)
        ):
            self._looking, self._waits = False, 0
            self._start_motion(now, BEYOND_REACH, notices)
            self._seeking = 0 if self._goal.settled else _LONGEST_SEEK  # goes on on the way
        elif self.is_searching:
            notices.append("looks for another configuration")

    def _start_search(self, now: Reference) -> None:
        assert self._target is not None
        self._looking = True
        self._elsewhere.begin_search(self._target, now.q)

    def _describe_unreachable(self) -> str:
        goal, kinematics = self._goal, self.kinematics
        error = goal.error / kinematics.scale
        words = f"unreachable: the nearest point is {np.linalg.norm(error[:3]):.3g} m"
        if len(error) > POSITION_ROWS:
            words += f" and {np.linalg.norm(error[3:]):.3g} rad"
        words += " away"
        at = (goal.q <= kinematics.lower) | (goal.q >= kinematics.upper)
        at &= kinematics.to_tool
        if at.any():
            names = ", ".join(kinematics.joint_names[j] for j in np.flatnonzero(at))
            words += f", {names} at the limit"
        return words


def sample_angles(motion: ReferenceMotion) -> Callable[[Array], Array]:
    """Return joint angles (K, N) at parts of a motion (K,): of its curve where it has one."""
    if isinstance(motion, TimedPath):
        return lambda part: np.asarray(motion.curve.compute_derivatives(part)[0])
    return lambda part: np.array([motion.evaluate_at(time).q for time in part * motion.duration])


def make_joint_path_limits(kinematics: Kinematics, config: MotionConfig) -> JointPathLimits:
    """Return the joints' limits, by robot description and parameters."""
    speed = np.minimum(SPEED_SHARE * kinematics.velocity_limit, config.velocity_limit)
    acceleration = np.minimum(
        ACCELERATION_SHARE * kinematics.acceleration_limit, config.acceleration_limit
    )
    jerk = acceleration / max(JERK_TIME, JERK_PERIODS * config.period)
    if config.jerk_limit > 0.0:
        jerk = np.full_like(acceleration, config.jerk_limit)
    return JointPathLimits(speed, acceleration, jerk, kinematics.effort_limit)


def _is_same(pose: Pose, second: Pose | None) -> bool:
    return second is not None and bool(
        (np.abs(pose.p_WT - second.p_WT) <= _SAME).all()
        and (np.abs(pose.R_WT - second.R_WT) <= _SAME).all()
    )
