"""Messages that the emulator takes from topics: motor commands, wrenches, reports of recorders."""

from collections.abc import Callable
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.serialization import deserialize_message

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.external_wrench import ExternalWrench
from arm_emulator.machine.plant.inputs import name_inputs
from arm_emulator.machine.session.command_buffer import DuplicateCommand
from arm_emulator.ros.messages.message_reader import refuse_bytes
from arm_emulator.ros.node.duplicate_nodes import get_start_time
from arm_emulator.ros.node.node_shell import ANSWER_SUB_QOS, COMMAND_SUB_QOS, EVENT_QOS
from arm_emulator_msgs.msg import MachineEvent, MotionStatus, MotorCommand, RecorderReport
from emulator_node.breakpoints import Breakpoints
from emulator_node.changes import Changes
from emulator_node.context import Context
from emulator_node.pacer import Pacer

# Topics of wrenches on links, and the axes of force and moment.
EXTERNAL_WRENCHES = {"external_wrench": "link", "external_wrench_in_world": "world"}


class Subscriptions:
    """Subscribes to topics, and passes their messages on.

    Attributes:
        answered: called when a command has been taken.
        commands: subscription to motor commands.
    """

    def __init__(self, own: Context, pacer: Pacer, changes: Changes, breaks: Breakpoints) -> None:
        self._breaks = breaks
        self._session, self._pacer, self._changes = own.session, pacer, changes
        self.answered: Callable[[], None] = lambda: None
        self._gate, self._outgoing, self._lock = own.gate, own.outgoing, own.lock
        self._diagnostics = own.diagnostics
        subscribe, qos = own.node.create_subscription, COMMAND_SUB_QOS
        self.commands = subscribe(
            MotorCommand,
            "motor_commands",
            partial(self._take_message, "motor_commands", self._take_command),
            ANSWER_SUB_QOS,
            only_from="servo",
            raw=True,
        )
        subscribe(PoseStamped, "tool_target", own.view.show_target, qos)
        if own.view.is_open:
            subscribe(MotionStatus, "motion/status", own.view.show_motion, EVENT_QOS)
        for topic, axes in EXTERNAL_WRENCHES.items():
            take = partial(self._take_message, topic, partial(self._take_wrench, topic, axes))
            subscribe(WrenchStamped, topic, take, qos)
        topic = "emulator/recorders"
        subscribe(RecorderReport, topic, partial(self._take_message, topic, self._take_report), qos)

    def _take_message(self, topic: str, take: Callable[[Any], None], message: Any) -> None:
        """Take a message of a topic, or report why it is refused."""
        with self._lock:
            try:
                take(message)
            except Refusal as reason:
                self._breaks.report_refused(topic, reason)

    def _take_command(self, data: bytes) -> None:
        if self._session.is_self_clocked:
            self._pacer.check_time()  # it has gone on since
        try:
            command: Any = deserialize_message(data, MotorCommand)
        except (RuntimeError, ValueError):
            raise refuse_bytes("motor_commands", MotorCommand, data) from None
        if command.machine not in (0, get_start_time()):
            self._diagnostics.count_input("motor_commands for another emulator")
            return
        try:
            names = command.joint_names
            inputs = (command.input_names, command.inputs)
            further = name_inputs("motor_commands", *inputs, len(names))
            self._session.offer(command.tick, names, command.command, further)
        except DuplicateCommand as reason:
            self._diagnostics.count_input(f"motor_commands {reason.kind}")
            return
        if self._outgoing.record is not None:
            self._outgoing.record.add_message(self.commands.topic_name, data)
        self._pacer.go_on()
        self.answered()

    def _take_report(self, report: RecorderReport) -> None:
        self._gate.take_report(report.recorder, report.written, report.leaving)
        self._diagnostics.values["recorders"] = len(self._gate.names)
        if self._gate.waited_for and self._session.is_answered:
            self._pacer.go_on()

    def _take_wrench(self, topic: str, axes: str, message: WrenchStamped) -> None:
        """Apply a wrench from this tick on, at the origin of the link that it names."""
        f, n = message.wrench.force, message.wrench.torque
        wrench = ExternalWrench((f.x, f.y, f.z), (n.x, n.y, n.z), axes=axes)
        session, link = self._session, message.header.frame_id
        if session.is_acting(link, wrench):
            return
        if behind := self._gate.find_full_recorder():
            rule = f"come when recorder {behind} has caught up"
            raise Refusal(topic, "message", rule, f"at tick {session.tick}")
        push = partial(session.set_external_wrench, link, wrench)
        self._changes.make_change(MachineEvent.KIND_EXTERNAL_WRENCH, push)
