"""Orders that wait for their time."""

from __future__ import annotations

import bisect
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.executor.controllers import Controllers, joint_limits, tool_limits
from arm_emulator.motion.executor.goal_status import CANCELLED, Kind, Progress, Reports, State
from arm_emulator.motion.executor.goals import Goal, PathGoal, TrajectoryGoal
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.motion.model.pose import Pose
from arm_emulator.motion.planner.tool_controller import Controller
from arm_emulator.motion.trajectory.joint_trajectory import JointTrajectory, TrajectoryPoint
from arm_emulator.motion.trajectory.tolerances import Allowed, Tolerances
from arm_emulator.motion.trajectory.tool_path import ToolPath

MOST_TARGETS = 10_000  # that wait for their time
LONGEST_WAIT_NS = 3_600_000_000_000  # an hour; a stamp of the wall clock is decades ahead


class GoalQueue:
    """Orders by their times, at most one for each."""

    def __init__(self) -> None:
        self._waiting: list[tuple[int, AcceptedGoal]] = []  # in the order of their times

    def __iter__(self) -> Iterator[AcceptedGoal]:
        return (taken for _, taken in list(self._waiting))

    def check_room(self, kind: Kind, time_ns: int) -> None:
        """Refuse one more order, of a kind and for a time [ns], if too many wait.

        Raises:
            Refusal: there is no room.
        """
        if self._at(time_ns) is None and len(self._waiting) >= MOST_TARGETS:
            rule = f"be one of at most {MOST_TARGETS} that wait for their time"
            raise Refusal(kind.topic, "the target", rule, "one more")

    def put(self, time_ns: int, taken: AcceptedGoal) -> AcceptedGoal | None:
        """Add an order for a time [ns]; return the one in whose place it comes."""
        before = self._at(time_ns)
        if before is not None:
            self.remove(before)
        place = bisect.bisect_left(self._waiting, time_ns, key=lambda item: item[0])
        self._waiting.insert(place, (time_ns, taken))
        return before

    def put_first(self, taken: AcceptedGoal) -> None:
        """Add an order that begins at once, before all others."""
        self._waiting.insert(0, (0, taken))

    def remove(self, taken: AcceptedGoal) -> None:
        """Take an order away."""
        self._waiting = [one for one in self._waiting if one[1] is not taken]

    def due(self, time_ns: int) -> AcceptedGoal | None:
        """Take the first order whose time has come [ns]; None: no order is due."""
        return self._waiting.pop(0)[1] if self.next_due(time_ns) else None

    def next_due(self, time_ns: int) -> AcceptedGoal | None:
        """Return the first order whose time has come [ns], and leave it."""
        first = self._waiting[0] if self._waiting else None
        return first[1] if first is not None and first[0] <= time_ns else None

    def _at(self, time_ns: int) -> AcceptedGoal | None:
        place = bisect.bisect_left(self._waiting, time_ns, key=lambda item: item[0])
        same = place < len(self._waiting) and self._waiting[place][0] == time_ns
        return self._waiting[place][1] if same else None


def check_wait(kind: Kind, time_ns: int, now_ns: int) -> None:
    """Refuse an order that begins too late [ns].

    Raises:
        Refusal: more than `LONGEST_WAIT_NS` after `now_ns`.
    """
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
    state: State = State.ACCEPTED
    way: str = ""
    """Newest published report."""

    @property
    def replaces(self) -> Progress:
        """Progress of an order in whose place this one comes."""
        if not self.number:
            return Progress(State.ABORTED, CANCELLED)
        what = self.order.kind.name.lower().replace("_", " ")
        return Progress(State.REPLACED, f"by {what} {self.number}")

    def report(self, reports: Reports, progress: Progress, anew: bool = False) -> None:
        """Take over the state of a progress, and report what is new, or anything `anew`.

        After a final state only an unreachable target may still be reached.
        """
        later = self.state is State.UNREACHABLE and progress.state is State.REACHED
        if self.state.final and not later:
            return
        silent = progress.state is self.state is State.MOVING and not anew
        self.state = progress.state
        if silent or not self.number:
            return
        reports.add(progress, self.order.kind, self.number, self.order.stamp_ns)


def trajectory_goal(
    controller: Controller | None,
    config: MotionConfig,
    names: Sequence[str],
    points: Sequence[TrajectoryPoint],
    stamp_ns: int,
    tolerances: Callable[[Tolerances], Tolerances],
) -> TrajectoryGoal:
    """Return the order for a joint trajectory; arguments as those of
    `MotionExecutor.add_trajectory`.

    Raises:
        Refusal: see `JointTrajectory`, or no arm.
    """
    kinematics = _known(controller, "joint_trajectory")
    joints, limits = kinematics.joint_names, joint_limits(kinematics, config)
    trajectory = JointTrajectory(joints, limits, names, points, stamp_ns, config.may_end_moving)
    default = Tolerances(
        Allowed.alike(len(joints), config.path_tolerance),
        Allowed.alike(len(joints), config.goal_tolerance),
        config.goal_time,
    )
    return TrajectoryGoal(trajectory, tolerances(default))


def path_goal(
    controller: Controller | None,
    config: MotionConfig,
    poses: Sequence[Pose],
    stamp_ns: int,
    times_ns: Sequence[int] | None,
) -> PathGoal:
    """Return the order for a tool path; arguments as those of `MotionExecutor.add_path`.

    Raises:
        Refusal: see `ToolPath`, or no arm.
    """
    kinematics = _known(controller, "tool_path")
    turning = kinematics.turns_tool
    # A free orientation must not take time.
    level = [pose if turning else Pose(pose.p_WT, np.eye(3)) for pose in poses]
    limits, arcs, blend = tool_limits(config), config.path_arcs, config.path_blend
    return PathGoal(ToolPath(level, limits, stamp_ns, times_ns, arcs, blend))


def stop_goal(laws: Controllers) -> TrajectoryGoal:
    """Return the order to come to rest."""
    names = laws.controller.kinematics.joint_names
    anything = Allowed.alike(len(names), 0.0)
    limits = joint_limits(laws.controller.kinematics, laws.config)
    return TrajectoryGoal(JointTrajectory(names, limits, (), ()), Tolerances(anything, anything))


def _known(controller: Controller | None, where: str) -> Kinematics:
    if controller is None:
        raise Refusal(where, "the message", "come after the robot description", "none so far")
    return controller.kinematics
