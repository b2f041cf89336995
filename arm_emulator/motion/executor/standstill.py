"""Joints while some of them cannot move, by power or brakes, and motions that slow down."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from arm_emulator.base.arrays import Array
from arm_emulator.motion.executor.controllers import Controllers, make_jerk_limited_velocity
from arm_emulator.motion.executor.goal_status import MOVING, GoalProgress, GoalState, Kind
from arm_emulator.motion.executor.goals import Goal, Planned
from arm_emulator.motion.model.joint_reference import JointSetpoint, Reference, ReferenceMotion
from arm_emulator.motion.trajectory.online_trajectory import Rest
from arm_emulator.motion.trajectory.time_scaling import TimeScaled

Flags = npt.NDArray[np.bool_]


class Standstill:
    """The reference of an arm that waits.

    A joint that cannot move is commanded to its measured position and speed, so that its brake
    never opens on a difference. The others come to rest, from their commanded motion
    or, after a standstill, from the measured one.
    """

    def __init__(self, controllers: Controllers, now: Reference) -> None:
        self._names = controllers.controller.kinematics.joint_names
        self._joints = make_jerk_limited_velocity(
            controllers.controller.kinematics, controllers.config, margin=0.0
        )
        self._joints.take_over(now)
        self._led = np.ones(len(now.q), dtype=bool)  # joints that follow the reference

    @property
    def is_over(self) -> bool:
        """Whether all joints can move, and rest."""
        return bool(self._led.all()) and not self._joints.is_moving

    @property
    def reference(self) -> Reference:
        """Commanded positions of the joints, at rest."""
        return Reference.make_rest(self._joints.now.q)

    @property
    def words(self) -> str:
        """Reason of the wait, as text."""
        blocked = [name for name, led in zip(self._names, self._led, strict=True) if not led]
        return f"waits for power and brakes of {', '.join(blocked)}" if blocked else "comes to rest"

    def compute_setpoint(self, q: Array, v: Array | None, movable: Flags) -> JointSetpoint:
        """Return the joint targets of this motion period.

        Args:
            q: measured angles of the links (N,) [rad or m].
            v: their measured speeds (N,); None: not measured.
            movable: which joints can move (N,).
        """
        now, on = self._joints.now, movable & self._led
        moves = np.zeros_like(q) if v is None else v
        self._joints.take_over(
            Reference(np.where(on, now.q, q), np.where(on, now.v, moves), np.where(on, now.a, 0.0))
        )
        self._led = movable
        now = self._joints.now
        return JointSetpoint(now.q, self._joints.stop_joints(), None, now)


_SECONDS = 1e-9
_HARDER = 2.0  # jerk, of that of ways: a way at its limit could not be left before its end


class StopGoal(Goal):
    """Comes to rest on a way that is known to be free, instead of each joint independently."""

    kind = Kind.JOG

    def __init__(self, controllers: Controllers, now_ns: int, planned: Planned) -> None:
        self._motion: ReferenceMotion = planned.motion
        since = planned.elapsed
        if not isinstance(planned.motion, TimeScaled):  # which slows down already
            limits = controllers.planner.limits
            limits = replace(limits, jerk=_HARDER * limits.jerk)
            self._motion = TimeScaled(planned.motion, since, 1.0, 0.0, limits)
            since = 0.0
        self._began_ns = now_ns - round(since / _SECONDS)

    def begin_motion(self, controllers: Controllers, now_ns: int, reference: Reference) -> None:
        """See `Goal`."""
        controllers.leading = None

    def go_on(self, controllers: Controllers, now_ns: int, reference: Reference) -> None:
        """See `Goal`."""
        self._motion, self._began_ns = Rest(reference.q), now_ns

    def compute_setpoint(self, controllers: Controllers, now_ns: int, q: Array) -> JointSetpoint:
        """See `Goal`."""
        now, then = (
            self.evaluate_reference(now_ns),
            self.evaluate_reference(now_ns + controllers.period_ns),
        )
        self._at_ns = now_ns + controllers.period_ns
        return JointSetpoint(now.q, (then.q - now.q) / controllers.config.period, None, now, then)

    def evaluate_reference(self, now_ns: int) -> Reference:
        """See `Goal`."""
        return self._motion.evaluate_at((now_ns - self._began_ns) * _SECONDS)

    def get_planned(self) -> Planned:
        """See `Goal`."""
        return Planned(self._motion, (self._at_ns - self._began_ns) * _SECONDS)

    def compute_progress(self, now_ns: int, q: Array, v: Array | None) -> GoalProgress:
        """See `Goal`."""
        over = (now_ns - self._began_ns) * _SECONDS > self._motion.duration
        return GoalProgress(GoalState.REACHED, "at rest") if over else MOVING
