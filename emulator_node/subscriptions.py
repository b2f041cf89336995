"""Messages that the emulator takes from topics: motor commands, wrenches, reports of recorders."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.serialization import deserialize_message

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.external_wrench import ExternalWrench
from arm_emulator.machine.plant.inputs import named_inputs
from arm_emulator.machine.session.command_buffer import DuplicateCommand
from arm_emulator.ros.duplicate_nodes import started
from arm_emulator.ros.message_reader import no_message
from arm_emulator.ros.node_shell import ANSWER_SUB_QOS, COMMAND_SUB_QOS, EVENT_QOS
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
        self._gate, self._outbox, self._lock = own.gate, own.outbox, own.lock
        self._diagnostics, node = own.diagnostics, own.node
        subscribe, qos = node.create_subscription, COMMAND_SUB_QOS
        self.commands = subscribe(
            MotorCommand,
            "motor_commands",
            self._on_command,
            ANSWER_SUB_QOS,
            only_from="servo",
            raw=True,
        )
        subscribe(PoseStamped, "tool_target", own.view.target, qos)
        if own.view.open:
            subscribe(MotionStatus, "motion/status", own.view.motion, EVENT_QOS)
        for topic, axes in EXTERNAL_WRENCHES.items():
            subscribe(WrenchStamped, topic, partial(self._on_wrench, topic, axes), qos)
        subscribe(RecorderReport, "emulator/recorders", self._on_recorder, qos)

    def _on_command(self, data: bytes) -> None:
        with self._lock:
            if self._session.is_self_clocked:
                self._pacer.look()  # it has gone on since
            try:
                command: Any = deserialize_message(data, MotorCommand)
            except (RuntimeError, ValueError):
                self._breaks.refused(
                    "motor_commands", no_message("motor_commands", MotorCommand, data)
                )
                return
            if command.machine not in (0, started()):
                self._diagnostics.count("motor_commands for another emulator")
                return
            try:
                names = command.joint_names
                given = (command.input_names, command.inputs)
                further = named_inputs("motor_commands", *given, len(names))
                self._session.offer(command.tick, names, command.command, further)
            except DuplicateCommand as reason:
                self._diagnostics.count(f"motor_commands {reason.kind}")
                return
            except Refusal as reason:
                self._breaks.refused("motor_commands", reason)
                return
            if self._outbox.record is not None:
                self._outbox.record.put(self.commands.topic_name, data)
            self._pacer.go_on()
            self.answered()

    def _on_recorder(self, report: RecorderReport) -> None:
        with self._lock:
            try:
                self._gate.on_report(report)
            except Refusal as reason:
                self._breaks.refused("emulator/recorders", reason)
                return
            if self._gate.waited_for and self._session.answered:
                self._pacer.go_on()

    def _on_wrench(self, topic: str, axes: str, message: WrenchStamped) -> None:
        """Apply a wrench from this tick on, at the origin of the link that it names."""
        f, n = message.wrench.force, message.wrench.torque
        wrench = ExternalWrench((f.x, f.y, f.z), (n.x, n.y, n.z), axes=axes)
        with self._lock:
            session, link = self._session, message.header.frame_id
            try:
                if session.acts_already(link, wrench):
                    return
                if behind := self._gate.without_room():
                    rule = f"come when recorder {behind} has caught up"
                    raise Refusal(topic, "message", rule, f"at tick {session.tick}")
                push = partial(session.set_external_wrench, link, wrench)
                self._changes.make(MachineEvent.KIND_EXTERNAL_WRENCH, push)
            except Refusal as reason:
                self._breaks.refused(topic, reason)
