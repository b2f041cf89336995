"""Orders of an arm during execution: hold its tool, follow its joints, or a path."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.motion.executor.controllers import Controllers
from arm_emulator.motion.executor.goal_status import MOVING, Kind, Progress, State
from arm_emulator.motion.executor.path_monitor import PathMonitor
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.joint_reference import JointSetpoint, Motion, Reference
from arm_emulator.motion.model.kinematics import POSITION_ROWS
from arm_emulator.motion.model.pose import Pose
from arm_emulator.motion.planner.limited_joint_trajectory import (
    DelayedTrajectory,
    MotionInSeconds,
    TimedMotion,
    within_limits,
)
from arm_emulator.motion.planner.target_planner import TargetPlanner, angles_over
from arm_emulator.motion.planner.tool_controller import Controller
from arm_emulator.motion.planner.tool_path_planner import plan_path
from arm_emulator.motion.trajectory.joint_trajectory import JointTrajectory
from arm_emulator.motion.trajectory.resumed import Resumed
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

    motion: Motion
    gone: float
    """Time within it at the end of the motion period [s]."""


class Goal(Protocol):
    """Interface of all orders.

    Attributes:
        kind: of the request.
        stamp_ns: logical time from which it holds [ns]; 0: at once.
    """

    kind: Kind
    stamp_ns: int

    @property
    def way(self) -> str:
        """Kind of its way and the reason, as text; empty: unknown."""

    def begin(self, laws: Controllers, now_ns: int, reference: Reference) -> None:
        """Take over from `reference`.

        Raises:
            Refusal: it cannot be begun so. Nothing has changed then.
        """

    def go_on(self, laws: Controllers, now_ns: int, reference: Reference) -> None:
        """Continue after a standstill, from rest at `reference`.

        Raises:
            Refusal: it cannot be continued so. Nothing has changed then.
        """

    def instruct(self, laws: Controllers, now_ns: int, q: Array) -> JointSetpoint:
        """Return the joint targets of this motion period.

        Raises:
            PlanningError: a motion that would begin now leads to a collision, or far past its end.
                Nothing has changed then.
        """

    def reference(self, now_ns: int) -> Reference | None:
        """Return the joints' commanded motion; None: that of the last instruction."""

    def planned(self) -> Planned | None:
        """Return its motion, after `instruct`, on which parts keep apart; None: not known."""

    def progress(self, now_ns: int, q: Array, v: Array | None) -> Progress:
        """Return its progress, after `instruct`, by the measured angles and speeds."""


class TargetGoal:
    """Order to bring the tool to a pose."""

    kind = Kind.TOOL_TARGET

    def __init__(self, stamp_ns: int, pose: Pose) -> None:
        self.stamp_ns, self.pose = stamp_ns, pose
        self._held: Array | None = None

    def begin(self, laws: Controllers, now_ns: int, reference: Reference) -> None:
        """See `Goal`."""
        self._law, self._arrival = laws.controller, _Arrival(laws.config)
        if laws.leading is not self._law:
            self._law.begin_moving(reference)
            laws.leading = self._law

    def go_on(self, laws: Controllers, now_ns: int, reference: Reference) -> None:
        """See `Goal`."""
        laws.leading = None
        self._held = None
        self.begin(laws, now_ns, reference)

    @property
    def way(self) -> str:
        """See `Goal`."""
        return self._law.way

    def instruct(self, laws: Controllers, now_ns: int, q: Array) -> JointSetpoint:
        """See `Goal`."""
        if self._held is not None:
            return JointSetpoint(self._held)
        instruction = self._law.update(q, self.pose)
        if self._law.coming is None and self._arrival.stalls(now_ns):
            # Eq. (6) would never give up.
            self._held = q
        return instruction

    def reference(self, now_ns: int) -> Reference | None:
        """See `Goal`."""
        return self._law.coming

    def planned(self) -> Planned | None:
        """See `Goal`."""
        return _planned(self._law) if isinstance(self._law, TargetPlanner) else None

    def progress(self, now_ns: int, q: Array, v: Array | None) -> Progress:
        """See `Goal`."""
        return self._arrival.progress(now_ns, self._law, q, v)


class PathGoal:
    """Order to move the tool along a path."""

    kind = Kind.TOOL_PATH

    def __init__(self, path: ToolPath) -> None:
        self.stamp_ns, self._path = path.stamp_ns, path
        self.way = ""

    def begin(self, laws: Controllers, now_ns: int, reference: Reference) -> None:
        """See `Goal`."""
        law, leading = laws.ways, laws.leading
        config = laws.config
        if leading is not law:
            law.begin_moving(reference)
        scaled = config.trajectory_limits == "scale"
        self._motion = motion = plan_path(law, self._path, reference, now_ns, scaled)
        _check(laws, self.kind, motion)
        laws.leading = law
        law.follow(self._motion)
        self._law, self._arrival = law, _Arrival(config)
        self._watch = PathMonitor(law.kinematics, self._path.poses, config.tool_path_tolerance)
        self.way = f"in {self._motion.duration:.3g} s"

    def go_on(self, laws: Controllers, now_ns: int, reference: Reference) -> None:
        """See `Goal`."""
        law = self._law
        left = Resumed(law.motion, law.gone, reference, law.limits)
        _check(laws, self.kind, left)
        law.begin_moving(reference)
        laws.leading = law
        law.follow(left)
        self.way = f"goes on, in {left.duration:.3g} s"

    def instruct(self, laws: Controllers, now_ns: int, q: Array) -> JointSetpoint:
        """See `Goal`."""
        instruction = self._law.go_on(q, self._path.poses[-1])
        self._watch.see(instruction.q, q)
        return instruction

    def reference(self, now_ns: int) -> Reference | None:
        """See `Goal`."""
        return self._law.coming

    def planned(self) -> Planned:
        """See `Goal`."""
        return _planned(self._law)

    def progress(self, now_ns: int, q: Array, v: Array | None) -> Progress:
        """See `Goal`."""
        if self._watch.broken:
            return Progress(State.ABORTED, f"{PATH_TOLERANCE}: {self._watch.broken}")
        if not self._law.resting:
            return MOVING
        progress = self._arrival.progress(now_ns, self._law, q, v)
        missed = self._watch.missed
        if progress.state is State.REACHED and missed:
            return replace(progress, state=State.ABORTED, reason=f"{PATH_TOLERANCE}: {missed}")
        return progress


class TrajectoryGoal:
    """Order to move the joints along a trajectory."""

    kind = Kind.JOINT_TRAJECTORY

    def __init__(self, trajectory: JointTrajectory, tolerances: Tolerances) -> None:
        self.stamp_ns, self.trajectory = trajectory.stamp_ns, trajectory
        self._tolerances = tolerances
        self._motion: TimedMotion

    def begin(self, laws: Controllers, now_ns: int, reference: Reference) -> None:
        """See `Goal`."""
        start_ns = self.stamp_ns or now_ns
        scaled = laws.config.trajectory_limits == "scale"
        motion = within_limits(laws.ways, self.trajectory, now_ns, start_ns, reference, scaled)
        self._follow(laws, motion, now_ns)
        self._start_ns = start_ns
        laws.leading = None

    def go_on(self, laws: Controllers, now_ns: int, reference: Reference) -> None:
        """See `Goal`."""
        left = DelayedTrajectory(self._motion, self._at_ns, now_ns, reference, laws.ways.limits)
        self._follow(laws, left, now_ns)

    def _follow(self, laws: Controllers, motion: TimedMotion, now_ns: int) -> None:
        whole = MotionInSeconds(motion, now_ns)
        if not self.trajectory.stops:
            _check(laws, self.kind, whole)
        self._motion, self._whole, self._began_ns, self._at_ns = motion, whole, now_ns, now_ns

    @property
    def way(self) -> str:
        """See `Goal`."""
        return self._motion.way

    def instruct(self, laws: Controllers, now_ns: int, q: Array) -> JointSetpoint:
        """See `Goal`."""
        self._at_ns, self._period = now_ns, laws.config.period
        now, then = (self._motion.at(now_ns + t) for t in (0, laws.period_ns))
        effort = None
        if not self.trajectory.stops:
            effort = self.trajectory.effort(self._motion.asked_ns(now_ns), self._start_ns)
        v = (then.q - now.q) / (laws.period_ns * _SECONDS)
        return JointSetpoint(now.q, v, effort, now, then)

    def reference(self, now_ns: int) -> Reference | None:
        """See `Goal`."""
        return self._motion.at(now_ns)

    def planned(self) -> Planned | None:
        """See `Goal`."""
        gone = (self._at_ns - self._began_ns) * _SECONDS + self._period
        return None if self.trajectory.stops else Planned(self._whole, gone)

    def progress(self, now_ns: int, q: Array, v: Array | None) -> Progress:
        """See `Goal`."""
        asked = self._motion.at(now_ns)
        q_error, v_error = asked.q - q, None if v is None else asked.v - v
        names = self.trajectory.joint_names
        late = (now_ns - self._motion.end_ns) * _SECONDS
        if late < 0.0:
            broken = self._tolerances.path.broken(names, q_error, v_error)
            return Progress(State.ABORTED, f"{PATH_TOLERANCE}: {broken}") if broken else MOVING
        broken = self._tolerances.goal.broken(names, q_error, v_error)
        if not broken:
            return Progress(State.REACHED)
        if 0.0 < self._tolerances.goal_time < late:
            return Progress(State.ABORTED, f"{GOAL_TOLERANCE} after {late:.3g} s: {broken}")
        return MOVING


def _planned(law: TargetPlanner) -> Planned:
    return Planned(law.motion, law.gone)


def _check(laws: Controllers, kind: Kind, motion: Motion) -> None:
    """Check a motion to its end.

    Raises:
        PlanningError: parts would touch.
    """
    if laws.guard is not None:
        laws.guard.check(kind.topic, angles_over(motion))


class _Arrival:
    """Judges by the measured tool whether it has arrived and rests, or has stopped short."""

    def __init__(self, config: MotionConfig) -> None:
        self._config = config
        self._best = math.inf
        self._best_at: int | None = None

    def stalls(self, now_ns: int) -> bool:
        """Whether the tool has come no nearer for a while."""
        return self._best_at is not None and (now_ns - self._best_at) * _SECONDS >= PATIENCE

    def progress(self, now_ns: int, law: Controller, q: Array, v: Array | None) -> Progress:
        """Return the tool's progress, by measured angles and speeds."""
        config, error = self._config, law.error
        distance = float(np.linalg.norm(error[:POSITION_ROWS]))
        angle = float(np.linalg.norm(error[POSITION_ROWS:])) if len(error) > POSITION_ROWS else 0.0
        size = max(distance / config.reached_within, angle / config.reached_within_angle)
        shown = angle if len(error) > POSITION_ROWS else math.nan
        rests = law.resting and self._rests(law, q, v)
        if self._best_at is None or size < _SMALLER * self._best or size <= 1.0:
            self._best, self._best_at = size, now_ns
        if size <= 1.0 and rests:
            return Progress(State.REACHED, "", distance, shown)
        if not law.resting and law.coming is not None:
            self._best_at = now_ns
        if rests and self.stalls(now_ns):
            return Progress(State.UNREACHABLE, "; ".join(law.notices), distance, shown)
        return Progress(State.MOVING, "", distance, shown)

    def _rests(self, law: Controller, q: Array, v: Array | None) -> bool:
        """Whether the measured tool needs more than `_STAYS` to leave what counts as reached."""
        if v is None:
            return True
        speed = law.kinematics.jacobian(q) @ v
        return bool(
            np.linalg.norm(speed[:POSITION_ROWS]) * _STAYS <= self._config.reached_within
            and np.linalg.norm(speed[POSITION_ROWS:]) * _STAYS <= self._config.reached_within_angle
        )
