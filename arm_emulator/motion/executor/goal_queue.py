"""Orders that wait for their time."""

from __future__ import annotations

import bisect
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.executor.controllers import (
    Controllers,
    make_joint_limits,
    make_tool_limits,
)
from arm_emulator.motion.executor.goal_status import (
    CANCELLED,
    GoalProgress,
    GoalReports,
    GoalState,
    Kind,
)
from arm_emulator.motion.executor.goals import Goal, PathGoal, TrajectoryGoal
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.motion.model.pose import Pose
from arm_emulator.motion.planner.tool_controller import Controller
from arm_emulator.motion.trajectory.joint_trajectory import JointTrajectory, TrajectoryPoint
from arm_emulator.motion.trajectory.tolerances import Allowed, Tolerances
from arm_emulator.motion.trajectory.tool_path import ToolPath

MAX_TARGETS = 10_000  # that wait for their time
LONGEST_WAIT_NS = 3_600_000_000_000  # an hour; a stamp of the wall clock is decades ahead


class GoalQueue:
    """Orders by their times, at most one for each."""

    def __init__(self) -> None:
        self._waiting: list[AcceptedGoal] = []  # in the order of their times

    def __iter__(self) -> Iterator[AcceptedGoal]:
        return iter(list(self._waiting))

    def check_room(self, kind: Kind, time_ns: int) -> None:
        """Refuse one more order, of a kind and for a time [ns], if too many wait."""
        if self._find_at(time_ns) is None and len(self._waiting) >= MAX_TARGETS:
            rule = f"be one of at most {MAX_TARGETS} that wait for their time"
            raise Refusal(kind.topic, "the target", rule, "one more")

    def add_goal(self, taken: AcceptedGoal) -> AcceptedGoal | None:
        """Add an order; return the one of the same time in whose place it comes."""
        before = self._find_at(taken.order.stamp_ns)
        if before is not None:
            self._waiting.remove(before)
        bisect.insort_left(self._waiting, taken, key=_read_stamp)
        return before

    def put_first(self, taken: AcceptedGoal) -> None:
        """Add an order that begins before all others."""
        self._waiting.insert(0, taken)

    def remove_goal(self, taken: AcceptedGoal) -> None:
        """Take an order away."""
        self._waiting.remove(taken)

    def take_due(self, time_ns: int) -> AcceptedGoal | None:
        """Take the first order whose time has come [ns]; None: no order is due."""
        return self._waiting.pop(0) if self.find_due(time_ns) else None

    def find_due(self, time_ns: int) -> AcceptedGoal | None:
        """Return the first order whose time has come [ns], and leave it."""
        first = self._waiting[0] if self._waiting else None
        return first if first is not None and _read_stamp(first) <= time_ns else None

    def _find_at(self, time_ns: int) -> AcceptedGoal | None:
        place = bisect.bisect_left(self._waiting, time_ns, key=_read_stamp)
        first = next(iter(self._waiting[place : place + 1]), None)
        return first if first is not None and _read_stamp(first) == time_ns else None


def _read_stamp(taken: AcceptedGoal) -> int:
    return taken.order.stamp_ns


def check_wait(kind: Kind, time_ns: int, now_ns: int) -> None:
    """Refuse an order that begins too late [ns]."""
    if time_ns - now_ns > LONGEST_WAIT_NS:
        rule = f"be at most {LONGEST_WAIT_NS * 1e-9:g} s after logical time {now_ns * 1e-9:g} s"
        valid = "0 for at once, or a time of the topic clock (use_sim_time)"
        raise Refusal(kind.topic, "header.stamp", rule, f"{time_ns * 1e-9:.10g} s", valid)


@dataclass(eq=False)
class AcceptedGoal:
    """An order that was accepted."""

    order: Goal
    number: int
    """Number among those of its kind; 0: an internal one, without reports."""
    begins_ns: int = 0
    """Logical time at which it begins at the earliest."""
    state: GoalState = GoalState.ACCEPTED
    path_text: str = ""
    """Newest published report."""

    @property
    def replaces(self) -> GoalProgress:
        """Progress of an order in whose place this one comes."""
        if not self.number:
            return GoalProgress(GoalState.ABORTED, CANCELLED)
        name = self.order.kind.name.lower().replace("_", " ")
        return GoalProgress(GoalState.REPLACED, f"by {name} {self.number}")

    def report_progress(
        self, reports: GoalReports, progress: GoalProgress, always: bool = False
    ) -> None:
        """Take over the state of a progress, and report what is new, or anything if `always`.

        After a final state only an unreachable target may still be reached.
        """
        later = self.state is GoalState.UNREACHABLE and progress.state is GoalState.REACHED
        if self.state.is_final and not later:
            return
        silent = progress.state is self.state is GoalState.MOVING and not always
        self.state = progress.state
        if silent or not self.number:
            return
        reports.add_report(progress, self.order.kind, self.number, self.order.stamp_ns)


def make_trajectory_goal(
    controller: Controller | None,
    config: MotionConfig,
    names: Sequence[str],
    points: Sequence[TrajectoryPoint],
    stamp_ns: int,
    tolerances: Callable[[Tolerances], Tolerances],
) -> TrajectoryGoal:
    """Return the order for a joint trajectory; arguments as those of
    `MotionExecutor.add_trajectory`.
    """
    kinematics = _require_kinematics(controller, "joint_trajectory")
    joints, limits = kinematics.joint_names, make_joint_limits(kinematics, config)
    trajectory = JointTrajectory(joints, limits, names, points, stamp_ns, config.may_end_moving)
    default = Tolerances(
        Allowed.make_equal(len(joints), config.path_tolerance),
        Allowed.make_equal(len(joints), config.goal_tolerance),
        config.goal_time,
    )
    return TrajectoryGoal(trajectory, tolerances(default))


def make_path_goal(
    controller: Controller | None,
    config: MotionConfig,
    poses: Sequence[Pose],
    stamp_ns: int,
    times_ns: Sequence[int] | None,
) -> PathGoal:
    """Return the order for a tool path; arguments as those of `MotionExecutor.add_path`."""
    kinematics = _require_kinematics(controller, "tool_path")
    turning = kinematics.has_orientation
    # A free orientation must not take time.
    level = [pose if turning else Pose(pose.p_WT, np.eye(3)) for pose in poses]
    limits, arcs, blend = make_tool_limits(config), config.path_arcs, config.path_blend
    return PathGoal(ToolPath(level, limits, stamp_ns, times_ns, arcs, blend))


def make_stop_goal(controllers: Controllers) -> TrajectoryGoal:
    """Return the order to come to rest."""
    names = controllers.controller.kinematics.joint_names
    anything = Allowed.make_equal(len(names), 0.0)
    limits = make_joint_limits(controllers.controller.kinematics, controllers.config)
    return TrajectoryGoal(JointTrajectory(names, limits, (), ()), Tolerances(anything, anything))


def _require_kinematics(controller: Controller | None, where: str) -> Kinematics:
    if controller is None:
        raise Refusal(where, "the message", "come after the robot description", "none so far")
    return controller.kinematics
