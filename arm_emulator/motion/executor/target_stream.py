"""Tool targets that come many times a second, as one motion.

The last of them are taken as points of a parabola in time, for the place and for the turn: so the
motion is known where it is now, and where it will be when the next period ends. A mean speed of the
past would lag every curve by the time over which it is a mean.
"""

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from arm_emulator.base.arrays import Array
from arm_emulator.motion.executor.controllers import Controllers, make_jerk_limited_velocity
from arm_emulator.motion.executor.goal_status import MOVING, GoalProgress, Kind
from arm_emulator.motion.executor.goals import Goal, Planned, TargetGoal
from arm_emulator.motion.executor.tool_directions import ToolDirections
from arm_emulator.motion.model.joint_reference import JointSetpoint, Reference
from arm_emulator.motion.model.kinematics import POSE_ROWS, POSITION_ROWS, Kinematics
from arm_emulator.motion.model.pose import Pose

GAP = 0.1  # s: targets farther apart in time are no stream
MIN_TARGETS = 3  # targets in a row
FASTEST, FASTEST_TURN = 2.0, 6.0  # m/s, rad/s: targets farther apart than that are no motion
MEMORY, PERIODS, MIN_STORED = (
    0.06,
    1.6,
    4,
)  # s, motion periods and targets that make the motion, at least
_SECONDS = 1e-9


@dataclass(frozen=True, eq=False)
class StreamMotion:
    """Motion of a stream's target since its newest one.

    Attributes:
        time_ns: logical time of the newest target [ns].
        pose: of it.
        terms: place, speed and acceleration from there on, each translation and rotation
            (3, 6) [m, rad, s].
    """

    time_ns: int
    pose: Pose
    terms: Array

    def compute_age(self, now_ns: int) -> float:
        """Return the time since the newest target [s]."""
        return (now_ns - self.time_ns) * _SECONDS

    def evaluate_at(self, age: float) -> tuple[Pose, Array, Array]:
        """Return pose, speed and acceleration (6,) at an age [m, rad, s]."""
        place, speed, acceleration = self.terms
        move = place + age * speed + 0.5 * age**2 * acceleration
        pose = Pose.computed(
            self.pose.p_WT + move[:POSITION_ROWS],
            pin.exp3(move[POSITION_ROWS:]) @ self.pose.R_WT,
        )
        return pose, speed + age * acceleration, acceleration


@dataclass(eq=False)
class TargetStream:
    """Targets that may be a stream.

    Args:
        period: motion period [s], for which the motion is foretold.

    Attributes:
        posture: joint angles at the first of them, which redundant joints come back to (N,).
    """

    period: float
    posture: Array = field(default_factory=lambda: np.zeros(0))
    _targets: list[tuple[int, Pose]] = field(default_factory=list)
    _count: int = 0

    def take_target(self, time_ns: int, pose: Pose, q: Array) -> None:
        """Take the newest target.

        Args:
            time_ns: logical time at which it begins to hold [ns].
            pose: of it.
            q: where the joints are commanded to be (N,).
        """
        last = self._targets[-1] if self._targets else (time_ns, pose)
        since = (time_ns - last[0]) * _SECONDS
        if not 0.0 < since <= GAP or not _is_slow(_compute_step(last[1], pose) / since):
            self._targets, self._count, self.posture = [], 0, q
        self._targets.append((time_ns, pose))
        self._count += 1
        memory = max(MEMORY, PERIODS * self.period)
        while (
            len(self._targets) > MIN_STORED and (time_ns - self._targets[1][0]) * _SECONDS > memory
        ):
            del self._targets[0]

    def fit_motion(self) -> StreamMotion | None:
        """Return the motion of which the newest target is a point; None: it is a single one."""
        if self._count < MIN_TARGETS:
            return None
        time_ns, newest = self._targets[-1]
        t = np.array([(then - time_ns) * _SECONDS for then, _ in self._targets])
        moves = np.empty((len(t), POSE_ROWS))
        moves[:, :POSITION_ROWS] = np.array([pose.p_WT for _, pose in self._targets]) - newest.p_WT
        moves[:, POSITION_ROWS:] = _compute_rotations(
            np.array([pose.R_WT for _, pose in self._targets]) @ newest.R_WT.T
        )
        span = -t[0]
        powers = np.stack([np.ones_like(t), t / span, 0.5 * (t / span) ** 2], axis=1)
        terms = np.linalg.lstsq(powers, moves, rcond=None)[0]
        return StreamMotion(time_ns, newest, terms / span ** np.arange(3)[:, None])


def _is_slow(twist: Array) -> bool:
    move, turn = twist[:POSITION_ROWS], twist[POSITION_ROWS:]
    return bool(move @ move <= FASTEST**2 and turn @ turn <= FASTEST_TURN**2)


def _compute_rotations(R: Array) -> Array:
    """Return the rotation vectors of rotations (K, 3, 3) below half a turn, (K, 3) [rad]."""
    across = 0.5 * np.stack([R[:, i, j] - R[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1)
    sines = np.linalg.norm(across, axis=1, keepdims=True)
    cosines = 0.5 * (np.trace(R, axis1=1, axis2=2)[:, None] - 1.0)
    rotations: Array = across * np.arctan2(sines, cosines) / np.maximum(sines, 1e-300)
    return rotations


def _compute_step(before: Pose, after: Pose) -> Array:
    both = np.empty(POSE_ROWS)
    both[:POSITION_ROWS] = after.p_WT - before.p_WT
    both[POSITION_ROWS:] = pin.log3(after.R_WT @ before.R_WT.T)
    return both


# The tool follows the motion of the targets (`TargetStream`). In each motion period it goes to the
# position, speed and acceleration of that motion at the period's end. When no more targets come, it
# comes to rest at the last one.

NEAR, NEAR_TURN = 0.1, 0.5  # m, rad: a tool farther from its target goes there by a way of its own
GAIN, MAX_SHARE = 15.0, 0.4  # 1/s, of the tool's distance, and part of it in a period at most
BACK = 2.0  # 1/s, of redundant joints' distance from their posture
_AHEAD = 1e-3  # s, over which the change of joint speeds is taken


def is_near(kinematics: Kinematics, q: Array, target: TargetGoal) -> bool:
    """Return whether a tool is near enough to its target to go on with a stream."""
    error = kinematics.tool_error(q, target.pose)
    move, turn = error[:POSITION_ROWS], error[POSITION_ROWS:]
    return bool(move @ move <= NEAR**2 and turn @ turn <= NEAR_TURN**2)


class StreamGoal(Goal):
    """Follows the motion of a stream."""

    kind = Kind.TOOL_TARGET

    def __init__(self, target: TargetGoal, motion: StreamMotion, posture: Array) -> None:
        self.stamp_ns = target.stamp_ns
        self._target, self._motion, self._posture = target, motion, posture

    def begin_motion(self, controllers: Controllers, now_ns: int, reference: Reference) -> None:
        """See `Goal`."""
        self._joints = make_jerk_limited_velocity(
            controllers.controller.kinematics, controllers.config, margin=0.0
        )
        self._joints.take_over(reference)
        self._rests = False
        controllers.leading = None

    def compute_setpoint(self, controllers: Controllers, now_ns: int, q: Array) -> JointSetpoint:
        """See `Goal`."""
        age = self._motion.compute_age(now_ns)
        if not self._rests and age > GAP:
            self._rests = True
            self._target.begin_motion(controllers, now_ns, self._joints.now)
        if self._rests:
            return self._target.compute_setpoint(controllers, now_ns, q)
        kinematics, now = controllers.controller.kinematics, self._joints.now
        period = controllers.config.period
        coming = now.q + period * (now.v + 0.5 * period * now.a)
        pose, twist, acceleration = self._motion.evaluate_at(age + period)
        error = np.zeros(POSE_ROWS)
        error[: kinematics.rows] = kinematics.tool_error(coming, pose)
        here = ToolDirections(kinematics, coming)
        leads = here.compute_speeds(twist, controllers.config).v
        then = ToolDirections(kinematics, coming + _AHEAD * leads)
        a = (
            then.compute_speeds(twist + _AHEAD * acceleration, controllers.config).v - leads
        ) / _AHEAD
        nearer = twist + min(GAIN, MAX_SHARE / period) * error
        v = here.compute_speeds(nearer, controllers.config, self._joints.limit_brake_share).v
        v = v + here.project_idle(BACK * (self._posture - coming))
        share = self._joints.limit_shares(now.q, v).min()
        mean = self._joints.advance_towards(v * share, alone=False, a=a * share)
        return JointSetpoint(now.q, mean, None, now)

    def evaluate_reference(self, now_ns: int) -> Reference | None:
        """See `Goal`."""
        return self._target.evaluate_reference(now_ns) if self._rests else self._joints.now

    def get_planned(self) -> Planned | None:
        """See `Goal`."""
        return self._target.get_planned() if self._rests else None

    def compute_progress(self, now_ns: int, q: Array, v: Array | None) -> GoalProgress:
        """See `Goal`."""
        return self._target.compute_progress(now_ns, q, v) if self._rests else MOVING
