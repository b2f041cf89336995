"""Instructions to the servo, one per motion period: the current order, results of the others.

One class: every order shares the state of the motion in progress, hence the length.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.bound import EFFORT, POSITION, VELOCITY
from arm_emulator.motion.executor.controllers import Controllers
from arm_emulator.motion.executor.goal_queue import (
    AcceptedGoal,
    GoalQueue,
    check_wait,
    make_path_goal,
    make_stop_goal,
    make_trajectory_goal,
)
from arm_emulator.motion.executor.goal_status import (
    CANCELLED,
    MOVING,
    GoalProgress,
    GoalReports,
    GoalState,
    Kind,
)
from arm_emulator.motion.executor.goals import Goal, Planned, TargetGoal
from arm_emulator.motion.executor.jog import JogCommand
from arm_emulator.motion.executor.jog_goal import JogGoal
from arm_emulator.motion.executor.standstill import Flags, Standstill, StopGoal
from arm_emulator.motion.executor.target_stream import StreamGoal, TargetStream, is_near
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.joint_reference import JointSetpoint, PlanningError, Reference
from arm_emulator.motion.model.pose import Pose
from arm_emulator.motion.planner.target_planner import LOST
from arm_emulator.motion.planner.tool_controller import Controller
from arm_emulator.motion.trajectory.joint_trajectory import TrajectoryPoint
from arm_emulator.motion.trajectory.tolerances import Tolerances

_Q = POSITION.rename("q")
_Q_TARGET = POSITION.rename("q_target")
_V_TARGET = VELOCITY.rename("v_target")
_TAU = EFFORT.rename("tau_feedforward")


class MotionExecutor:
    """Answers joint angles with joint targets.

    Until something else holds these are the angles at first. Of tool targets, joint trajectories
    and tool paths the newest holds, from its time on: one that begins takes over from the angles
    and speeds commanded so far, so that nothing jumps.

    Its results are checked. If one is not finite, or beyond the bound of joint positions, the
    instructor forgets everything and holds the arm where it is.

    Attributes:
        restarts: how often that happened.
        trouble: why, the last time, in words.
        reports: results of targets, trajectories and paths.
        progress: that of the order that holds now, by the newest measurement.
    """

    def __init__(self, config: MotionConfig | None = None) -> None:
        self.restarts = 0
        self.trouble = ""
        self.reports = GoalReports()
        self.progress = MOVING
        self._config = config or MotionConfig()
        self._coming = GoalQueue()
        self._active: AcceptedGoal | None = None
        self._controllers: Controllers | None = None
        self._stream = TargetStream(self._config.period)
        self.start_over()

    def start_over(self, reason: str = "the motion controller was reset") -> None:
        """Forget all orders, and the arm's position."""
        for taken in [self._active, *self._coming]:
            if taken is not None:
                taken.report_progress(self.reports, GoalProgress(GoalState.ABORTED, reason))
        self._hold: Array | None = None
        self._active = None
        self._standstill: Standstill | None = None
        self._only: Planned | None = None  # the only motion on which it can stop
        self._coming = GoalQueue()
        self._now_ns: int | None = None  # logical time of the newest joint angles
        self._last: tuple[int, JointSetpoint] | None = None
        if self._controllers is not None:
            self._controllers.leading = None
            self._controllers.feedforward.reset_estimate()
            self._controllers.shaped.pass_reference()

    def set_parameters(self, config: MotionConfig) -> None:
        """Continue with other parameters; a path that has begun keeps its speed."""
        self._config = config
        if self._controllers is not None:
            self._controllers.set_parameters(config)

    @property
    def is_holding(self) -> bool:
        """Whether only the initial angles hold yet."""
        return self._active is None

    @property
    def leading(self) -> Controller | None:
        """The control law that moves the tool now, or None."""
        if self._active is None or self._controllers is None:
            return None
        return self._controllers.leading

    @property
    def wind_up(self) -> Array:
        """Assumed wind-up of the gears in the newest targets (N,) [rad]."""
        return np.zeros(0) if self._controllers is None else self._controllers.feedforward.wind_up

    @property
    def torques_unknown(self) -> str:
        """Reason for which requested torques are missing; empty: none are missing."""
        return "" if self._controllers is None else self._controllers.feedforward.trouble

    def add(self, time_ns: int, target: Pose) -> None:
        """Take a tool target that holds from a logical time [ns] on, until something else does.

        Of two with the same time the newer wins; a time that is past means the next motion period.
        """
        self._take_goal(Kind.TOOL_TARGET, time_ns, time_ns, lambda: TargetGoal(time_ns, target))

    def add_trajectory(
        self,
        controller: Controller | None,
        names: Sequence[str],
        points: Sequence[TrajectoryPoint],
        stamp_ns: int = 0,
        tolerances: Callable[[Tolerances], Tolerances] = lambda default: default,
    ) -> int:
        """Take a joint trajectory; see `JointTrajectory`. Return its number.

        Args:
            controller: of the arm; None: not known yet.
            names: of the joints that it moves.
            points: of it.
            stamp_ns: logical time at which it starts [ns]; 0: at once.
            tolerances: makes its own of those of the parameters.
        """
        return self._take_goal(
            Kind.JOINT_TRAJECTORY,
            stamp_ns,
            stamp_ns,
            lambda: make_trajectory_goal(
                controller, self._config, names, points, stamp_ns, tolerances
            ),
        )

    def add_path(
        self,
        controller: Controller | None,
        poses: Sequence[Pose],
        stamp_ns: int = 0,
        times_ns: Sequence[int] | None = None,
    ) -> int:
        """Take a tool path; see `ToolPath`. Return its number.

        Args:
            controller: of the arm; None: not known yet.
            poses: of the tool.
            stamp_ns: logical time at which the way to the first one begins [ns]; 0: at once.
            times_ns: when the tool shall be in each [ns]; None: as the parameters state.
        """
        begins_ns = max(stamp_ns, times_ns[0]) if times_ns else stamp_ns
        return self._take_goal(
            Kind.TOOL_PATH,
            stamp_ns,
            begins_ns,
            lambda: make_path_goal(controller, self._config, poses, stamp_ns, times_ns),
        )

    def take_jog(self, command: JogCommand) -> None:
        """Take a jog command: it holds from the next period on, as long as jog commands last."""
        for order in (self.jogging, *(taken.order for taken in self._coming)):
            if isinstance(order, JogGoal):
                order.command = command
                return
        self._take_goal(Kind.JOG, 0, 0, lambda: JogGoal(command))

    @property
    def jogging(self) -> JogGoal | None:
        """The jog that holds now, or None."""
        active = self._active
        jogs = active is not None and not active.state.is_final
        return active.order if active and jogs and isinstance(active.order, JogGoal) else None

    def cancel_trajectory(self, number: int) -> None:
        """Abort a joint trajectory by its number: the joints come to rest if it moves them."""
        for taken in self._coming:
            if taken.order.kind is Kind.JOINT_TRAJECTORY and taken.number == number:
                self._coming.remove_goal(taken)
                taken.report_progress(self.reports, GoalProgress(GoalState.ABORTED, CANCELLED))
                return
        active = self._active
        if self._controllers is None or active is None or active.state.is_final:
            return
        if active.order.kind is Kind.JOINT_TRAJECTORY and active.number == number:
            self._coming.put_first(AcceptedGoal(make_stop_goal(self._controllers), 0))

    def compute_setpoint(
        self,
        controller: Controller,
        time_ns: int,
        q: Array,
        v: Array | None = None,
        movable: Flags | None = None,
        tau: Array | None = None,
    ) -> JointSetpoint:
        """Return the joint targets at a logical time [ns].

        Args:
            controller: the control law for the arm.
            time_ns: of the joint angles; never before that of the last call.
            q: joint angles measured at the motors (N,) [rad].
            v: measured joint speeds (N,) [rad/s]; None: not measured.
            movable: which joints can move (N,): with power, and an open brake; None: all.
            tau: torques that the motors give, at the links (N,) [N m]; None: not measured.

        Raises:
            Refusal: q is not finite or too large; nothing has changed then.
        """
        _Q.check_values("motion_controller", q.tolist())
        controllers = self._get_controllers(controller)
        if movable is not None and not movable.all():
            # The measured positions hold, under any command.
            controllers.feedforward.reset_estimate()
        controllers.feedforward.observe_torques(tau, movable)
        measured, links = q, controllers.feedforward.compute_link_angles(q)
        # The arm as if it had got the reference without the delay of its shaper.
        q, true_v = links + controllers.shaped.lag, v
        v = None if v is None else v + controllers.shaped.v_lag
        try:
            self._wait_for_joints(controllers, time_ns, q, movable)
            self._take_up(controllers, time_ns, q)
            if self._standstill is None:
                of_links = self._compute_setpoint(controllers, time_ns, q, v)
            else:
                can = np.ones(len(links), dtype=bool) if movable is None else movable
                of_links = self._standstill.compute_setpoint(links, true_v, can)
            instruction = controllers.feedforward.complete_setpoint(
                controllers.shaped.filter_setpoint(of_links)
            )
            answer = instruction.q, instruction.v, instruction.tau
            for bound, values in zip((_Q_TARGET, _V_TARGET, _TAU), answer, strict=True):
                if values is not None:
                    bound.check_values("motion_controller", values.tolist())
        except (Refusal, ArithmeticError, np.linalg.LinAlgError) as error:
            # q is within its bound and orders were checked on arrival. The cause is this object's
            # state, or a robot description with impossible numbers.
            self.restarts += 1
            self.trouble = str(error)
            self.start_over(self.trouble)
            self._hold = links
            of_links, instruction = JointSetpoint(links), JointSetpoint(measured)
        self._last = time_ns, of_links
        return instruction

    @property
    def waits_for(self) -> str:
        """Reason why the arm waits at a standstill, as text; empty: it moves."""
        return "" if self._standstill is None else self._standstill.words

    def _wait_for_joints(
        self, controllers: Controllers, time_ns: int, q: Array, movable: Flags | None
    ) -> None:
        """Stand still while a joint cannot move, and until all rest."""
        if self._standstill is None:
            if movable is not None and not movable.all():
                now = controllers.shaped.compute_sent(self._find_reference(controllers, time_ns, q))
                self._standstill = Standstill(controllers, now)
                controllers.shaped.pass_reference()
                self._only = None
            return
        if not self._standstill.is_over or (movable is not None and not movable.all()):
            return
        rest, active = self._standstill.reference, self._active
        self._standstill = None
        if active is None:
            self._hold = rest.q if self._hold is not None else None
            return
        begins = active.state is GoalState.ACCEPTED
        try:
            (active.order.begin_motion if begins else active.order.go_on)(
                controllers, time_ns, rest
            )
        except Refusal as reason:
            active.report_progress(self.reports, GoalProgress(GoalState.REFUSED, str(reason)))
            self._active, self._hold = None, rest.q

    def _get_controllers(self, controller: Controller) -> Controllers:
        if self._controllers is None or self._controllers.controller is not controller:
            self._controllers = Controllers(controller, self._config)
        return self._controllers

    def _take_goal(self, kind: Kind, time_ns: int, begins_ns: int, make: Callable[[], Goal]) -> int:
        try:
            if self._now_ns is not None:
                check_wait(kind, begins_ns, self._now_ns)
            order = make()
            self._coming.check_room(kind, time_ns)
        except Refusal as reason:
            self.reports.refuse_goal(kind, time_ns, reason)
            raise
        taken = AcceptedGoal(order, self.reports.take_next_number(kind), begins_ns)
        taken.report_progress(self.reports, GoalProgress(GoalState.ACCEPTED))
        before = self._coming.add_goal(taken)
        if before is not None:
            before.report_progress(self.reports, taken.replaces)
        return taken.number

    def _take_up(self, controllers: Controllers, time_ns: int, q: Array) -> None:
        """Start the orders whose time has come."""
        early = list(self._coming) if self._now_ns is None else []  # than the first joint states
        for taken_early in early:
            try:
                check_wait(taken_early.order.kind, taken_early.begins_ns, time_ns)
            except Refusal as reason:
                self._coming.remove_goal(taken_early)
                taken_early.report_progress(
                    self.reports, GoalProgress(GoalState.REFUSED, str(reason))
                )
        self._now_ns = time_ns
        while (taken := self._coming.take_due(time_ns)) is not None:
            reference, order = self._find_reference(controllers, time_ns, q), taken.order
            if isinstance(order, TargetGoal):
                self._stream.take_target(order.stamp_ns or time_ns, order.pose, reference.q)
            if (newer := self._coming.find_due(time_ns)) is not None:
                taken.report_progress(self.reports, newer.replaces)
                continue
            if isinstance(order, TargetGoal):
                taken.order = self._select_stream(controllers, order, reference.q)
            try:
                taken.order.begin_motion(controllers, time_ns, reference)
            except Refusal as reason:
                taken.report_progress(self.reports, GoalProgress(GoalState.REFUSED, str(reason)))
                continue
            if self._active is not None:
                self._active.report_progress(self.reports, taken.replaces)
            self._active = taken

    def _select_stream(
        self, controllers: Controllers, order: TargetGoal, q: Array
    ) -> TargetGoal | StreamGoal:
        """Return the order for the newest target: itself, or that of its stream."""
        motion = self._stream.fit_motion()
        if motion is None or not is_near(controllers.controller.kinematics, q, order):
            return order
        return StreamGoal(order, motion, self._stream.posture)

    def _compute_setpoint(
        self, controllers: Controllers, time_ns: int, q: Array, v: Array | None
    ) -> JointSetpoint:
        taken = self._active
        if taken is None:
            if self._hold is None:
                self._hold = q
            return JointSetpoint(self._hold)
        try:
            instruction = taken.order.compute_setpoint(controllers, time_ns, q)
        except PlanningError as reason:  # nothing has changed
            before = taken.order.evaluate_reference(time_ns)
            assert before is not None
            moved = bool((before.v != 0.0).any())
            state = GoalState.ABORTED if moved else GoalState.REFUSED
            return self._halt_goal(controllers, time_ns, before, GoalProgress(state, str(reason)))
        shaped, progress = controllers.shaped, taken.order.compute_progress(time_ns, q, v)
        if not shaped.is_settled and progress.state in (GoalState.REACHED, GoalState.UNREACHABLE):
            progress = replace(progress, state=GoalState.MOVING, reason="")
        self.progress = progress
        path_text = taken.order.path_text
        if shaped.delay:
            later = f"{shaped.delay:.3g} s more by the shaper"
            path_text = f"{path_text}, {later}" if path_text else later
        if taken.state is GoalState.ACCEPTED or (
            taken.state is GoalState.MOVING and path_text != taken.path_text
        ):
            taken.path_text = path_text
            taken.report_progress(
                self.reports,
                replace(progress, state=GoalState.MOVING, reason=path_text),
                always=True,
            )
        taken.report_progress(self.reports, progress)
        if taken.state is GoalState.ABORTED:
            v = None if v is None else v - shaped.v_lag
            return self._stop_measured(controllers, time_ns, q - shaped.lag, v)
        return self._guard_setpoint(controllers, time_ns, q, instruction)

    def _guard_setpoint(
        self, controllers: Controllers, time_ns: int, q: Array, instruction: JointSetpoint
    ) -> JointSetpoint:
        """Return an instruction after which the arm can stop before a collision."""
        guard, taken = controllers.guard, self._active
        if guard is None or taken is None:
            return instruction
        if isinstance(taken.order, JogGoal) and self._only is None:
            return instruction  # jogs look ahead by themselves
        q, period = instruction.q, controllers.config.period
        v = np.zeros_like(q) if instruction.v is None else instruction.v
        now = instruction.now or Reference(q, v, np.zeros_like(q))
        then = taken.order.evaluate_reference(time_ns + controllers.period_ns)
        then = then or now.extrapolate_to(period, q + period * v)
        touching = guard.check_ahead(controllers.braking, now.q, then)
        if not touching:
            self._only = None
            return instruction
        planned = taken.order.get_planned()
        if planned is not None and guard.is_free(planned.motion):
            self._only = planned
            return instruction
        why = GoalProgress(GoalState.ABORTED, f"collision: {touching} would touch")
        return self._halt_goal(controllers, time_ns, now, why)

    def _halt_goal(
        self, controllers: Controllers, time_ns: int, now: Reference, why: GoalProgress
    ) -> JointSetpoint:
        """Abort the order, and come to rest from the commanded motion."""
        if self._active is not None:
            self._active.report_progress(self.reports, why)
        stop: JogGoal | StopGoal
        if self._only is None:
            stop = JogGoal.make_stop(time_ns, len(now.q))
        else:
            stop = StopGoal(controllers, time_ns, self._only)
        stop.begin_motion(controllers, time_ns, now)
        self._active = AcceptedGoal(stop, 0, state=GoalState.MOVING)
        instruction = stop.compute_setpoint(controllers, time_ns, now.q)
        if self._only is not None:
            self._only = stop.get_planned()
        return instruction

    def _stop_measured(
        self, controllers: Controllers, time_ns: int, q: Array, v: Array | None
    ) -> JointSetpoint:
        """Bring the joints to rest from their measured motion."""
        stop = make_stop_goal(controllers)
        still = np.zeros_like(q)
        q = controllers.feedforward.compute_rest_angles(q)
        stop.begin_motion(controllers, time_ns, Reference(q, still if v is None else v, still))
        self._active, self._only = AcceptedGoal(stop, 0), None
        return stop.compute_setpoint(controllers, time_ns, q)

    def _find_reference(self, controllers: Controllers, time_ns: int, q: Array) -> Reference:
        """Return the joints' commanded motion, or the measured one if they are far apart."""
        if self._standstill is not None:
            return self._standstill.reference
        still = np.zeros_like(q)
        reference = None if self._active is None else self._active.order.evaluate_reference(time_ns)
        if reference is None and self._last is not None:
            then, last = self._last
            if last.v is None:
                reference = Reference(last.q, still, still)
            else:
                reference = Reference(last.q + (time_ns - then) * 1e-9 * last.v, last.v, still)
        elif reference is None and self._hold is not None:
            reference = Reference(self._hold, still, still)
        scale = controllers.controller.kinematics.joint_scale
        if reference is None or not (np.abs(reference.q - q) <= LOST * scale).all():
            return Reference(q - controllers.shaped.lag, still, still)
        return reference
