"""Orders of an arm during execution: hold its tool, follow its joints, or a path."""

import math
from dataclasses import dataclass, replace

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.motion.executor.controllers import Controllers
from arm_emulator.motion.executor.goal_status import MOVING, GoalProgress, GoalState, Kind
from arm_emulator.motion.executor.path_monitor import PathMonitor
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.joint_reference import JointSetpoint, Reference, ReferenceMotion
from arm_emulator.motion.model.kinematics import POSITION_ROWS
from arm_emulator.motion.model.pose import Pose
from arm_emulator.motion.planner.limited_joint_trajectory import (
    DelayedTrajectory,
    TimedMotion,
    fit_trajectory,
)
from arm_emulator.motion.planner.target_planner import TargetPlanner, sample_angles
from arm_emulator.motion.planner.tool_controller import Controller
from arm_emulator.motion.planner.tool_path_planner import plan_path
from arm_emulator.motion.trajectory.joint_trajectory import JointTrajectory
from arm_emulator.motion.trajectory.time_scaling import Resumed
from arm_emulator.motion.trajectory.tolerances import Tolerances
from arm_emulator.motion.trajectory.tool_path import ToolPath

PATIENCE = 1.0  # s: an error that has not decreased for this long never will
_SMALLER = 0.99  # decrease that counts
_STAYS = 0.1  # s

# First words of the reasons for aborted trajectories.
PATH_TOLERANCE = "path tolerance"
GOAL_TOLERANCE = "goal tolerance"

_SECONDS = 1e-9


@dataclass(frozen=True)
class Planned:
    """A motion that was checked to its end before it began, and where an order is on it."""

    motion: ReferenceMotion
    elapsed: float
    """Time within it at the end of the motion period [s]."""


class Goal:
    """An order of any kind.

    Attributes:
        kind: of the request.
        stamp_ns: logical time from which it holds [ns]; 0: at once.
    """

    kind: Kind
    stamp_ns = 0

    @property
    def path_text(self) -> str:
        """Kind of its way and the reason, as text; empty: unknown."""
        return ""

    def begin_motion(self, controllers: Controllers, now_ns: int, reference: Reference) -> None:
        """Take over from `reference`.

        Raises:
            Refusal: it cannot be begun so. Nothing has changed then.
        """
        raise NotImplementedError

    def go_on(self, controllers: Controllers, now_ns: int, reference: Reference) -> None:
        """Continue after a standstill, from rest at `reference`.

        Raises:
            Refusal: it cannot be continued so. Nothing has changed then.
        """
        self.begin_motion(controllers, now_ns, reference)

    def compute_setpoint(self, controllers: Controllers, now_ns: int, q: Array) -> JointSetpoint:
        """Return the joint targets of this motion period.

        Raises:
            PlanningError: a motion that would begin now leads to a collision, or far past its end.
                Nothing has changed then.
        """
        raise NotImplementedError

    def evaluate_reference(self, now_ns: int) -> Reference | None:
        """Return the joints' commanded motion; None: that of the last instruction."""
        raise NotImplementedError

    def get_planned(self) -> Planned | None:
        """Return its motion, after `compute_setpoint`, on which parts keep apart, if known."""
        return None

    def compute_progress(self, now_ns: int, q: Array, v: Array | None) -> GoalProgress:
        """Return its progress, after `compute_setpoint`, by the measured angles and speeds."""
        raise NotImplementedError

    def _check_motion(self, controllers: Controllers, motion: ReferenceMotion) -> None:
        """Check a motion to its end."""
        if controllers.guard is not None:
            controllers.guard.check_motion(self.kind.topic, sample_angles(motion))


class _ToolGoal(Goal):
    """An order by which a control law moves the tool."""

    _law: Controller

    @property
    def path_text(self) -> str:
        """See `Goal`."""
        return self._law.path_text

    def evaluate_reference(self, now_ns: int) -> Reference | None:
        """See `Goal`."""
        return self._law.coming

    def get_planned(self) -> Planned | None:
        """See `Goal`."""
        law = self._law
        return Planned(law.motion, law.elapsed) if isinstance(law, TargetPlanner) else None


class TargetGoal(_ToolGoal):
    """Order to bring the tool to a pose."""

    kind = Kind.TOOL_TARGET

    def __init__(self, stamp_ns: int, pose: Pose) -> None:
        self.stamp_ns, self.pose = stamp_ns, pose
        self._rest_position: Array | None = None

    def begin_motion(self, controllers: Controllers, now_ns: int, reference: Reference) -> None:
        """See `Goal`."""
        self._law, self._arrival = controllers.controller, _Arrival(controllers.config)
        if controllers.leading is not self._law:
            self._law.begin_moving(reference)
            controllers.leading = self._law

    def go_on(self, controllers: Controllers, now_ns: int, reference: Reference) -> None:
        """See `Goal`."""
        controllers.leading = None
        self._rest_position = None
        self.begin_motion(controllers, now_ns, reference)

    def compute_setpoint(self, controllers: Controllers, now_ns: int, q: Array) -> JointSetpoint:
        """See `Goal`."""
        if self._rest_position is not None:
            return JointSetpoint(self._rest_position)
        instruction = self._law.update(q, self.pose)
        if self._law.coming is None and self._arrival.is_stalled(now_ns):
            # Eq. (6) would never give up.
            self._rest_position = q
        return instruction

    def compute_progress(self, now_ns: int, q: Array, v: Array | None) -> GoalProgress:
        """See `Goal`."""
        return self._arrival.compute_progress(now_ns, self._law, q, v)


class PathGoal(_ToolGoal):
    """Order to move the tool along a path."""

    kind = Kind.TOOL_PATH
    _law: TargetPlanner

    def __init__(self, path: ToolPath) -> None:
        self.stamp_ns, self._path = path.stamp_ns, path

    def begin_motion(self, controllers: Controllers, now_ns: int, reference: Reference) -> None:
        """See `Goal`."""
        law, config = controllers.planner, controllers.config
        if controllers.leading is not law:
            law.begin_moving(reference)
        scaled = config.trajectory_limits == "scale"
        motion = plan_path(law, self._path, reference, now_ns, scaled)
        self._check_motion(controllers, motion)
        controllers.leading = self._law = law
        law.follow(motion, f"in {motion.duration:.3g} s")
        self._arrival, self._shaped = _Arrival(config), controllers.shaped
        self._watch = PathMonitor(law.kinematics, self._path.poses, config.tool_path_tolerance)

    def go_on(self, controllers: Controllers, now_ns: int, reference: Reference) -> None:
        """See `Goal`."""
        law = self._law
        left = Resumed(law.motion, law.elapsed, reference, law.limits)
        self._check_motion(controllers, left)
        law.begin_moving(reference)
        controllers.leading = law
        law.follow(left, left.path_text)

    def compute_setpoint(self, controllers: Controllers, now_ns: int, q: Array) -> JointSetpoint:
        """See `Goal`."""
        instruction = self._law.go_on(q, self._path.poses[-1])
        self._watch.observe_angles(instruction.q, q - self._shaped.lag)  # where the tool truly is
        return instruction

    def compute_progress(self, now_ns: int, q: Array, v: Array | None) -> GoalProgress:
        """See `Goal`."""
        if self._watch.broken:
            return GoalProgress(GoalState.ABORTED, f"{PATH_TOLERANCE}: {self._watch.broken}")
        if not self._law.is_resting:
            return MOVING
        progress = self._arrival.compute_progress(now_ns, self._law, q, v)
        missed = self._watch.missed
        if progress.state is GoalState.REACHED and missed:
            return replace(progress, state=GoalState.ABORTED, reason=f"{PATH_TOLERANCE}: {missed}")
        return progress


class TrajectoryGoal(Goal):
    """Order to move the joints along a trajectory."""

    kind = Kind.JOINT_TRAJECTORY
    _motion: TimedMotion

    def __init__(self, trajectory: JointTrajectory, tolerances: Tolerances) -> None:
        self.stamp_ns, self.trajectory = trajectory.stamp_ns, trajectory
        self._tolerances = tolerances

    def begin_motion(self, controllers: Controllers, now_ns: int, reference: Reference) -> None:
        """See `Goal`."""
        start_ns = self.stamp_ns or now_ns
        scaled = controllers.config.trajectory_limits == "scale"
        motion = fit_trajectory(
            controllers.planner, self.trajectory, now_ns, start_ns, reference, scaled
        )
        self._follow_motion(controllers, motion, now_ns)
        self._late_ns = now_ns - start_ns  # when it began
        controllers.leading = None

    def go_on(self, controllers: Controllers, now_ns: int, reference: Reference) -> None:
        """See `Goal`."""
        since = self._compute_time(self._at_ns)
        left = DelayedTrajectory(self._motion, since, reference, controllers.planner.limits)
        self._follow_motion(controllers, left, now_ns)

    def _follow_motion(self, controllers: Controllers, motion: TimedMotion, now_ns: int) -> None:
        if not self.trajectory.is_stop:
            self._check_motion(controllers, motion)
        self._motion, self._began_ns, self._at_ns = motion, now_ns, now_ns

    def _compute_time(self, now_ns: int) -> float:
        """Return the time since its motion began [s]."""
        return (now_ns - self._began_ns) * _SECONDS

    @property
    def path_text(self) -> str:
        """See `Goal`."""
        return self._motion.path_text

    def compute_setpoint(self, controllers: Controllers, now_ns: int, q: Array) -> JointSetpoint:
        """See `Goal`."""
        self._at_ns, self._period = now_ns, controllers.config.period
        now, then = (
            self.evaluate_reference(now_ns),
            self.evaluate_reference(now_ns + controllers.period_ns),
        )
        effort = None
        if not self.trajectory.is_stop:
            requested_ns = self._motion.find_requested_ns(self._compute_time(now_ns))
            effort = self.trajectory.compute_effort(self._late_ns + requested_ns)
        v = (then.q - now.q) / (controllers.period_ns * _SECONDS)
        return JointSetpoint(now.q, v, effort, now, then)

    def evaluate_reference(self, now_ns: int) -> Reference:
        """See `Goal`."""
        return self._motion.evaluate_at(self._compute_time(now_ns))

    def get_planned(self) -> Planned | None:
        """See `Goal`."""
        elapsed = self._compute_time(self._at_ns) + self._period
        return None if self.trajectory.is_stop else Planned(self._motion, elapsed)

    def compute_progress(self, now_ns: int, q: Array, v: Array | None) -> GoalProgress:
        """See `Goal`."""
        expected = self.evaluate_reference(now_ns)
        q_error, v_error = expected.q - q, None if v is None else expected.v - v
        names = self.trajectory.joint_names
        late = self._compute_time(now_ns) - self._motion.duration
        if late < 0.0:
            broken = self._tolerances.path.describe_excess(names, q_error, v_error)
            return (
                GoalProgress(GoalState.ABORTED, f"{PATH_TOLERANCE}: {broken}") if broken else MOVING
            )
        broken = self._tolerances.goal.describe_excess(names, q_error, v_error)
        if not broken:
            return GoalProgress(GoalState.REACHED)
        if 0.0 < self._tolerances.goal_time < late:
            return GoalProgress(GoalState.ABORTED, f"{GOAL_TOLERANCE} after {late:.3g} s: {broken}")
        return MOVING


class _Arrival:
    """Judges by the measured tool whether it has arrived and rests, or has stopped short."""

    def __init__(self, config: MotionConfig) -> None:
        self._config = config
        self._best = math.inf
        self._best_at: int | None = None

    def is_stalled(self, now_ns: int) -> bool:
        """Whether the tool has come no nearer for a while."""
        return self._best_at is not None and (now_ns - self._best_at) * _SECONDS >= PATIENCE

    def compute_progress(
        self, now_ns: int, law: Controller, q: Array, v: Array | None
    ) -> GoalProgress:
        """Return the tool's progress, by measured angles and speeds."""
        config, error = self._config, law.error
        distance = float(np.linalg.norm(error[:POSITION_ROWS]))
        angle = float(np.linalg.norm(error[POSITION_ROWS:])) if len(error) > POSITION_ROWS else 0.0
        size = max(distance / config.reached_within, angle / config.reached_within_angle)
        reported_angle = angle if len(error) > POSITION_ROWS else math.nan
        rests = law.is_resting and self._is_resting(law, q, v)
        if self._best_at is None or size < _SMALLER * self._best or size <= 1.0:
            self._best, self._best_at = size, now_ns
        if size <= 1.0 and rests:
            return GoalProgress(GoalState.REACHED, "", distance, reported_angle)
        if not law.is_resting and law.coming is not None:
            self._best_at = now_ns
        if rests and self.is_stalled(now_ns):
            return GoalProgress(
                GoalState.UNREACHABLE, "; ".join(law.notices), distance, reported_angle
            )
        return GoalProgress(GoalState.MOVING, "", distance, reported_angle)

    def _is_resting(self, law: Controller, q: Array, v: Array | None) -> bool:
        """Whether the measured tool needs more than `_STAYS` to leave what counts as reached."""
        if v is None:
            return True
        speed = law.kinematics.jacobian(q) @ v
        return bool(
            np.linalg.norm(speed[:POSITION_ROWS]) * _STAYS <= self._config.reached_within
            and np.linalg.norm(speed[POSITION_ROWS:]) * _STAYS <= self._config.reached_within_angle
        )
