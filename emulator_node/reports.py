"""Messages that the emulator publishes: states, truth, time, events."""

import time
from array import array

import numpy as np
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from arm_emulator.machine.plant.call_arguments import make_truth
from arm_emulator.machine.plant.measured import Measured
from arm_emulator.machine.plant.measured_fields import MeasuredFields
from arm_emulator.ros.messages.event_words import describe_change
from arm_emulator.ros.messages.middleware import Numbers, Outgoing
from arm_emulator.ros.messages.time_stamp import convert_to_stamp, set_stamp
from arm_emulator.ros.node.duplicate_nodes import get_start_time
from arm_emulator.ros.node.node_shell import DESCRIPTION_QOS, EVENT_QOS, STATE_PUB_QOS
from arm_emulator_msgs.msg import MachineEvent, MotorState
from emulator_node.context import Context

TRUTH = ("position", "velocity", "effort")  # fields of emulator/joint_states


class Reports:
    """Publishes ticks of a session, and changes of its machine.

    Attributes:
        publishers: all of them.
        outgoing: those of each tick: states, true states and time.
        truth: ``arm_truth`` for what C publishes of it.
        ticks: number of ticks between messages of truth and time.
        published_at: when this tick's state was first published [s, monotonic].
        repeated_at: time of its newest publication.
        changes: number of changes by hand so far.

    Args:
        own: context with topics and machine.
        period: logical time between messages of truth and time [s], 0 for every tick.
    """

    def __init__(self, own: Context, period: float) -> None:
        self._session, self._outgoing = own.session, own.outgoing
        self._gate, self._view = own.gate, own.view
        session = own.session
        self.ticks = max(1, round(period / session.scene.servo_period))
        self._fields = MeasuredFields(session.scene, MotorState.get_fields_and_field_types())
        self.changes = 0
        rows = np.zeros((len(TRUTH), len(session.scene.joints)))
        self.truth = make_truth(q=rows[0], v=rows[1], gear_torque=rows[2])
        create = own.node.create_publisher
        self._of_ticks = (
            create(MotorState, "motor_states", STATE_PUB_QOS),
            create(JointState, "emulator/joint_states", STATE_PUB_QOS),
            create(Clock, "clock", STATE_PUB_QOS),
        )
        self.outgoing = self.create_messages(session.plant.measured_place, rows)
        self.motor_state, self.joint_state, self.clock = self.outgoing
        self._descriptions = create(String, "robot_description", DESCRIPTION_QOS)
        self._events = create(MachineEvent, "emulator/events", EVENT_QOS)
        self.publishers: list[Publisher] = [
            *self._of_ticks, self._descriptions, self._events,
        ]  # fmt: skip
        self.published_at = self.repeated_at = time.monotonic()

    def create_messages(
        self, measured: Measured, truth: Numbers
    ) -> tuple[Outgoing, Outgoing, Outgoing]:
        """Return the messages of each tick, filled by C from these places.

        Args:
            measured: arrays of measurements.
            truth: rows of `TRUTH`.
        """
        motor_state, joint_state, clock = self._of_ticks
        rows = list(zip(TRUTH, truth, strict=True))
        return (
            Outgoing(
                motor_state, self._make_empty_motor_state(), 0, self._fields.list_places(measured)
            ),
            Outgoing(joint_state, self._make_empty_truth(), 1, rows),
            Outgoing(clock, Clock(), 2),
        )

    def publish_description(self) -> None:
        """Publish the robot's description."""
        self._outgoing.publish_message(self._descriptions, String(data=self._session.scene.urdf))

    def publish_tick(self) -> None:
        """Publish this tick's state."""
        self.published_at = self.repeated_at = time.monotonic()
        session = self._session
        self._put_motor_state()
        if session.tick % self.ticks == 0:
            self._put_truth()
            self._set_time()
            self._outgoing.publish_message(self.clock.publisher, self.clock.layout.write_message())
        self._view.show_tick()

    def publish_change(self) -> None:
        """Publish this tick's state again, as changed by hand."""
        self.repeated_at = time.monotonic()
        self._put_motor_state()
        self._put_truth()
        self._view.show_tick()

    def repeat_tick(self) -> None:
        """Publish an unanswered state again, for a partner that came late or lost it."""
        self.repeated_at = time.monotonic()
        self._put_motor_state()
        if self._session.tick == 0:
            self._put_truth()

    def repeat_time(self) -> None:
        """Publish the newest time again.

        It is read with best effort: subscribers that lost it, or came later, get it now.
        """
        self._set_time()
        self.clock.publish_message()

    def refresh_messages(self) -> None:
        """Set the parts of messages that the code in C does not change."""
        self.motor_state.layout.message.powered = self._session.powered
        self.motor_state.layout.write_numbers()

    def publish_event(self, kind: int, saved: bytes) -> None:
        """Publish a change by hand, with the resulting machine."""
        session = self._session
        self.changes += 1
        event = MachineEvent(
            tick=session.tick,
            number=self.changes,
            kind=kind,
            powered=session.powered,
            state=array("B", saved),
            machine=get_start_time(),
        )
        event.header.stamp = convert_to_stamp(session.logical_ns)
        self._outgoing.publish_message(self._events, event)
        self._view.show_event(describe_change(kind, session.powered))

    def _set_time(self) -> None:
        session = self._session
        newest = session.tick - session.tick % self.ticks
        set_stamp(self.clock.layout.message.clock, newest * session.period_ns)

    def _put_truth(self) -> None:
        state, truth = self._session.state, self.joint_state.layout.message
        set_stamp(truth.header.stamp, self._session.logical_ns)
        for name, values in zip(TRUTH, (state.q, state.v, state.gear_torque), strict=True):
            getattr(truth, name)[:] = values
        self._outgoing.publish_message(
            self.joint_state.publisher, self.joint_state.layout.write_message()
        )

    def _make_empty_truth(self) -> JointState:
        """Return a true state with all its names and lengths."""
        scene = self._session.scene
        zeros = array("d", bytes(8 * len(scene.joints)))
        names = list(scene.joint_names)
        return JointState(name=names, position=zeros, velocity=zeros, effort=zeros)

    def _make_empty_motor_state(self) -> MotorState:
        """Return a motor state with all its names and lengths."""
        scene, measured = self._session.scene, self._session.measured
        message = MotorState(
            joint_names=list(scene.joint_names),
            machine=get_start_time(),
            imu_names=[imu.name for imu in scene.imus],
        )
        self._fields.size_message(message, measured)
        return message

    def _put_motor_state(self) -> None:
        session, message = self._session, self.motor_state.layout.message
        set_stamp(message.header.stamp, session.logical_ns)
        message.tick = session.tick
        message.powered = session.powered
        self._fields.fill_message(message, session.measured)
        self._gate.published += 1
        if self._outgoing.record is not None:
            self._outgoing.record.count_tick(session.tick)
        self._outgoing.publish_message(
            self.motor_state.publisher, self.motor_state.layout.write_message()
        )
