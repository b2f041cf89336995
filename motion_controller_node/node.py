"""ROS node `motion_controller`: targets and joint states in, joint targets out."""

if __name__ == "__main__":  # before slow imports
    import os
    import sys

    # Nothing is imported from the working folder, which -P leaves out by itself.
    if not sys.flags.safe_path and sys.path[0] != os.path.dirname(os.path.dirname(__file__)):
        sys.path[:] = [folder for folder in sys.path[1:] if folder != sys.path[0]]

    from arm_emulator.base.required_package import refuse_missing_modules
    from arm_emulator.ros.process.ctrl_c import end_at_once

    end_at_once(0)
    refuse_missing_modules("motion_controller")

from array import array
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Time
from rclpy.event_handler import QoSSubscriptionMatchedInfo, SubscriptionEventCallbacks
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.bound import BRAKE_CLOSED, EFFORT, POSITION, VELOCITY
from arm_emulator.base.validation.joint_order import JointOrder
from arm_emulator.base.validation.number import Number
from arm_emulator.motion.executor.goal_status import GoalState, Kind
from arm_emulator.motion.executor.motion_executor import MotionExecutor
from arm_emulator.motion.model.config import SECTIONS, MotionConfig
from arm_emulator.motion.model.kinematics import list_moving_joints
from arm_emulator.motion.planner.tool_controller import Controller, make_controller
from arm_emulator.ros.messages.time_stamp import (
    NANOSECONDS,
    check_time,
    convert_to_nanoseconds,
    convert_to_stamp,
)
from arm_emulator.ros.node.duplicate_nodes import DuplicateNodes
from arm_emulator.ros.node.managed_node import ManagedNode
from arm_emulator.ros.node.node_parameters import (
    accept_changes,
    declare_parameters,
    refuse_unknown_parameters,
    replace_parameters,
)
from arm_emulator.ros.node.node_shell import (
    COMMAND_QOS,
    DESCRIPTION_QOS,
    EVENT_QOS,
    NO_DESCRIPTION,
    STATE_SUB_QOS,
    Diagnostics,
    run_node,
)
from arm_emulator_msgs.msg import MachineEvent, MotionStatus, ServoState
from motion_controller_node.follow_action import (
    FollowAction,
    check_points,
    is_installed,
    read_tolerances,
)
from motion_controller_node.order_topics import PLURALS, OrderTopics

_MOVABLE = BRAKE_CLOSED.rename("movable")


class MotionControllerNode(ManagedNode):
    """The motion controller as a ROS node.

    It answers the joint states at every multiple of its period with joint targets of the same time
    stamp: the arm's initial position, until a tool target, a joint trajectory or a tool path
    takes effect. The state of each of them is published on `motion/status`.
    """

    def __init__(self) -> None:
        super().__init__("motion_controller")
        config = declare_parameters(self, MotionConfig)
        refuse_unknown_parameters(self, config, SECTIONS)
        self._config = self._read_sections(config, {})
        accept_changes(self, self._apply_changes, self._take_parameters)
        self._diagnostics = Diagnostics(self, "motion controller")
        self._duplicates = DuplicateNodes(
            self,
            self._diagnostics,
            "motion controller",
            "joint_targets",
            "the servo takes the targets of the first one",
        )
        self._diagnostics.values.update(dict.fromkeys(PLURALS.values(), 0))
        self._urdf = ""  # the newest description, and the arm's
        self._controller: Controller | None = None
        # In every state: it is published once.
        self.create_subscription(
            String,
            "robot_description",
            self._handle_description,
            DESCRIPTION_QOS,
            only_from="emulator",
        )
        self.start_lifecycle()

    def create_entities(self) -> None:
        """Create the topics and services."""
        self._period_ns = round(self._config.period * NANOSECONDS)
        self._controller = None
        self._motion = MotionExecutor(self._config)
        self._answer: JointState | None = None
        self._now_ns = 0  # of the newest joint states
        self._movable: tuple[Time, npt.NDArray[np.bool_]] | None = None  # by servo_states
        self._unanswered: JointState | None = None  # of which the servo's state is not here yet
        self._began_again = False  # the machine, by its emulator
        self._early: JointState | None = None  # of a time that begins again, not announced so far
        self._status = self.create_publisher(MotionStatus, "motion/status", EVENT_QOS)
        self._targets = self.create_publisher(JointState, "joint_targets", COMMAND_QOS)
        self._servo_reports = False  # whether the servo publishes its state
        self.create_subscription(
            ServoState,
            "servo_states",
            self._handle_servo_state,
            STATE_SUB_QOS,
            only_from="servo",
            event_callbacks=SubscriptionEventCallbacks(
                matched=self._handle_servo_matched, use_default_callbacks=False
            ),
        )
        # First: a reset is known before the joint states that follow it.
        self.create_subscription(
            MachineEvent, "emulator/events", self._handle_event, EVENT_QOS, only_from="emulator"
        )
        self.create_subscription(
            JointState, "joint_states", self._handle_joint_states, STATE_SUB_QOS, only_from="servo"
        )
        self._orders = OrderTopics(
            self,
            self._motion,
            self._diagnostics,
            self._report_status,
            lambda: (self._controller, self._config, self._now_ns),
        )
        self.create_service(Trigger, "~/reset", self._handle_reset)
        self._action: FollowAction | None = None
        if is_installed():
            self.housekeeping = 0.02  # s, wall: bounds the delay of goals
        self.cleanup.callback(self._end_action)
        if self._urdf:
            self._take_description(self._urdf)

    def begin_work(self) -> None:
        """Answer joint states."""
        self._duplicates.announce_node()
        if self._controller is None:
            self._diagnostics.report_warning(NO_DESCRIPTION)
        else:
            self._diagnostics.report_ok("waiting for joint_states")

    def stop_work(self) -> None:
        """Drop all targets, trajectories and paths."""
        self._start_over("the motion controller was deactivated")
        self._duplicates.withdraw_node()
        self._diagnostics.report_ok("inactive: no joint targets")

    def _end_action(self) -> None:
        if self._action is not None:
            self._action.destroy_server()

    def _read_sections(self, config: MotionConfig, changes: Mapping[str, Any]) -> MotionConfig:
        """Return parameters with the sections of the node, with some entries changed."""
        sections: dict[str, dict[str, Any]] = {section: {} for section in SECTIONS}
        for section_name, entries in sections.items():
            for name in self.get_parameters_by_prefix(section_name):
                entries[name] = self.get_parameter(f"{section_name}.{name}").value
        for name, value in changes.items():
            section, _, entry = name.partition(".")
            sections[section][entry] = value
        return config.add_sections(sections, f"node {self.get_name()}")

    def _apply_changes(self, changes: Mapping[str, Any]) -> MotionConfig:
        own = {name: value for name, value in changes.items() if name in vars(self._config)}
        others = {name: value for name, value in changes.items() if name not in own}
        return self._read_sections(replace_parameters(self, self._config, own), others)

    def _take_parameters(self, config: MotionConfig) -> None:
        """Work with other parameters from the next motion period on."""
        self._config = config
        if not self.configured:
            return
        self._motion.set_parameters(config)
        if self._controller is not None:
            self._controller.retune(config)

    def _start_over(self, reason: str) -> None:
        self._answer = self._early = self._unanswered = None
        self._began_again = False
        self._motion.start_over(reason)
        self._report_status()

    def _handle_description(self, message: String) -> None:
        if self._controller is not None and message.data == self._urdf:
            self._handle_new_time()  # of an emulator that was started again, or activated
            return
        if not self.configured:
            self._urdf = message.data
            return
        self._take_description(message.data)

    def _handle_event(self, event: MachineEvent) -> None:
        if event.kind == MachineEvent.KIND_RESET:
            self._handle_new_time()

    def _handle_new_time(self) -> None:
        """Expect joint states of an earlier time than those before: the emulator announces them.

        Stamps alone announce nothing: one message of an earlier time would end each motion.
        """
        self._began_again = self.configured and self._answer is not None
        early, self._early = self._early, None
        if self._began_again and early is not None:
            self._handle_joint_states(early)

    def _take_description(self, urdf: str) -> None:
        try:
            controller = make_controller(urdf, list_moving_joints(urdf), self._config)
        except Refusal as reason:
            self._diagnostics.refuse_input("robot_description", reason)
            return
        if self._controller is not None:  # targets for another arm
            self._start_over("the robot is another one")
        self._urdf, self._controller = urdf, controller
        self._order = JointOrder("joint_states", controller.kinematics.joint_names)
        if self._action is None and is_installed():  # clients may begin when the server exists
            self._action = FollowAction(self, self._handle_goal, self._handle_cancel)
        if self.active:
            self._diagnostics.report_ok("waiting for joint_states")

    def _handle_goal(self, goal: Any) -> int:
        """Accept a goal of the action; return its number among the trajectories.

        Raises:
            Refusal: the goal is refused, which is published.
        """
        if not self.active:
            rule = "come while the node is active"
            raise Refusal("follow_joint_trajectory", "goal", rule, self.state)
        trajectory = goal.trajectory
        kinematics = None if self._controller is None else self._controller.kinematics
        names = () if kinematics is None else kinematics.joint_names

        def take_goal() -> None:
            check_points(goal)
            self._orders.add_trajectory(
                trajectory, lambda default: read_tolerances(goal, names, default)
            )

        refusal = self._orders.take_order(Kind.JOINT_TRAJECTORY, trajectory.header, take_goal)
        if refusal is not None:
            raise refusal
        return self._motion.reports.numbers[Kind.JOINT_TRAJECTORY]

    def _handle_cancel(self, number: int) -> None:
        self._motion.cancel_trajectory(number)
        self._report_status()

    def _handle_servo_matched(self, info: QoSSubscriptionMatchedInfo) -> None:
        self._servo_reports = info.current_count > 0

    def _handle_servo_state(self, message: ServoState) -> None:
        if self._controller is None:
            return
        try:
            can = self._order.arrange_values(message.joint_names, message.movable, _MOVABLE)
        except Refusal as reason:
            self._diagnostics.refuse_input("servo_states", reason)
            return
        self._movable = message.header.stamp, can != 0.0
        waiting, self._unanswered = self._unanswered, None
        if waiting is not None and waiting.header.stamp == message.header.stamp:
            self._handle_joint_states(waiting)

    def _find_movable(self, stamp: Time) -> npt.NDArray[np.bool_] | None:
        """Return which joints the servo can move (N,); None: it is about to report it.

        A servo that is not ours does not: it moves all of them.
        """
        if self._movable is not None and self._movable[0] == stamp:
            return self._movable[1]
        if self._servo_reports:
            return None
        assert self._controller is not None
        return np.ones(len(self._controller.kinematics.joint_names), dtype=bool)

    def _handle_joint_states(self, message: JointState) -> None:
        controller = self._controller
        if controller is None:
            return
        try:
            now = check_time("joint_states", message.header.stamp)
            if now % self._period_ns != 0:
                return
            q = self._order.arrange_values(message.name, message.position, POSITION)
            v = self._read_optional(message, message.velocity, VELOCITY)
            tau = self._read_loads(message)
        except Refusal as reason:
            self._diagnostics.refuse_input("joint_states", reason)
            return
        if self._answer is not None and now <= convert_to_nanoseconds(self._answer.header.stamp):
            if message.header.stamp == self._answer.header.stamp:
                self._targets.publish(self._answer)  # a partner came late or lost it
                return
            if not self._began_again:
                self._refuse_earlier(message, now)
                return
            self._start_over("the machine began anew")
        movable = self._find_movable(message.header.stamp)
        if movable is None:
            self._unanswered = message
            return
        if self._answer is None:
            self._diagnostics.log.log_info("begun", "joint states arrive, targets are taken")
        self._now_ns = now
        instruction = self._motion.compute_setpoint(controller, now, q, v, movable, tau)
        self._report_goals()
        self._report_status()
        self._orders.publish_limit()
        # The instructor keeps published values within the bounds.
        answer = JointState(name=controller.kinematics.joint_names)
        answer.header.stamp = message.header.stamp
        answer.position = array("d", instruction.q.tobytes())
        if instruction.v is not None:
            answer.velocity = array("d", instruction.v.tobytes())
        if instruction.tau is not None:
            answer.effort = array("d", instruction.tau.tobytes())
        self._answer = answer
        self._targets.publish(answer)
        if self._action is not None and v is not None:
            names = list(controller.kinematics.joint_names)
            self._action.publish_feedback(message.header.stamp, names, instruction, q, v)

    def _refuse_earlier(self, message: JointState, time_ns: int) -> None:
        """Leave joint states of an earlier time unanswered, until the emulator announces them."""
        assert self._answer is not None
        self._early = message
        answered = convert_to_nanoseconds(self._answer.header.stamp) / NANOSECONDS
        if self._servo_reports:  # ours repeats what was not answered
            self._diagnostics.count_input("joint_states repeated late, or before their reset")
        elif time_ns == 0:
            rule = f"be set: those of {answered:g} s were answered, and no reset was announced"
            self._diagnostics.refuse_input(
                "joint_states", Refusal("joint_states", "header.stamp", rule, "0 s, unset")
            )
        else:
            self._diagnostics.count_input("joint_states of an earlier time, without a reset")

    def _read_loads(self, message: JointState) -> Array | None:
        """Return the loads of the motors; None of other servos: some have amperes as `effort`."""
        if not self._servo_reports:
            return None
        return self._read_optional(message, message.effort, EFFORT)

    def _read_optional(
        self, message: JointState, values: Sequence[float], bound: Number
    ) -> Array | None:
        """Return measured speeds or loads; None if they are missing or not sound."""
        try:
            if values:
                return self._order.arrange_values(message.name, values, bound)
        except Refusal:
            self._diagnostics.count_input(f"joint_states without a sound {bound.name}")
        return None

    def _report_status(self) -> None:
        """Publish the results of targets, trajectories and paths since the last time."""
        for report in self._motion.reports.take_reports():
            if self._action is not None:
                self._action.handle_report(report)
            message = MotionStatus(
                kind=int(report.kind),
                number=report.number,
                stamp=convert_to_stamp(report.stamp_ns),
                state=int(report.state),
                reason=report.reason,
                distance=report.distance,
                angle=report.angle,
            )
            message.header.stamp = convert_to_stamp(self._now_ns)
            self._status.publish(message)
            if (
                report.state.is_final and report.state is not GoalState.REFUSED
            ):  # `Diagnostics` logs refusals
                log, regular = self._diagnostics.log, (GoalState.REACHED, GoalState.REPLACED)
                (log.log_info if report.state in regular else log.warn_about)(
                    report.state.name, str(report)
                )

    def _report_goals(self) -> None:
        restarts = self._motion.restarts
        if restarts != self._diagnostics.values.get("began anew", 0):
            self._diagnostics.values["began anew"] = restarts
            self._diagnostics.report_error(f"{self._motion.trouble}; began anew, the arm is held")
            return
        if self._motion.torques_unknown:
            self._diagnostics.values["no torques"] = self._motion.torques_unknown
        if self._motion.waits_for:
            self._diagnostics.report_warning(self._motion.waits_for)
            return
        if self._motion.is_holding:
            self._diagnostics.report_ok("holding, no tool target yet")
            return
        jog = self._motion.jogging
        if jog is not None:
            (self._diagnostics.report_warning if jog.status else self._diagnostics.report_ok)(
                f"jog: {jog.words}"
            )
            return
        law = self._motion.leading
        if law is None:
            self._diagnostics.report_ok("following a joint trajectory, or holding its end")
            return
        if law.notices:
            self._diagnostics.report_warning("; ".join(law.notices))
        else:
            self._diagnostics.report_ok("moving the tool to its target")
        self._diagnostics.values["tool error [m]"] = f"{np.linalg.norm(law.error[:3]):.2e}"

    def _handle_reset(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        self._start_over("the motion controller was reset")
        response.success = True
        response.message = "all tool targets are dropped, the arm holds its position"
        return response


def main() -> None:
    """Entry point of `ros2 run arm_emulator motion_controller_node`."""
    run_node(MotionControllerNode)


if __name__ == "__main__":
    main()
