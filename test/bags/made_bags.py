"""Bags made without a network."""

from array import array
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message
from std_msgs.msg import Header

from arm_emulator import Session, load_scene
from arm_emulator.machine.plant.measured_fields import MeasuredFields
from arm_emulator.ros.messages.message_types import read_definition
from arm_emulator.ros.messages.time_stamp import convert_to_stamp
from arm_emulator.ros.recording.bag_metadata import Topic
from arm_emulator.ros.recording.bag_writer import BagWriter
from arm_emulator_msgs.msg import MotorCommand, MotorState

TYPES = {"/motor_states": MotorState, "/motor_commands": MotorCommand}


class EmulatorBag:
    """Writes what the emulator of a session sends, 1 us apart.

    Args:
        writer: of the bag.
        session: of which it is.
        kinds: of messages by their topics.
    """

    def __init__(
        self, writer: BagWriter, session: Session, kinds: Mapping[str, type] = TYPES
    ) -> None:
        self._writer, self._session, self._kinds, self._clock = writer, session, kinds, 10**18
        self._numbers = {}
        for topic, kind in kinds.items():
            name = f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
            self._numbers[topic] = writer.add_topic(Topic(topic, name, read_definition(name)))
        self._measured = MeasuredFields(session.scene, MotorState.get_fields_and_field_types())

    def send(self, topic: str, **fields: Any) -> None:
        self._clock += 1000
        if topic != "/motor_commands":
            fields["header"] = Header(stamp=convert_to_stamp(self._session.logical_ns))
        message = self._kinds[topic](**fields)
        if topic == "/motor_states":
            self._measured.size_message(message, self._session.measured)
        data = serialize_message(message)
        self._writer.write_message(self._numbers[topic], self._clock, self._clock, data)

    def report(self, machine: int = 0) -> None:
        """Send the present motor state."""
        session = self._session
        self.send("/motor_states", tick=session.tick, powered=session.powered, machine=machine,
                  joint_names=list(session.scene.joint_names),
                  imu_names=[imu.name for imu in session.scene.imus])  # fmt: skip

    def command(self, tick: int, voltage: list[float], **fields: Any) -> None:
        names = list(self._session.scene.joint_names)
        self.send("/motor_commands", tick=tick, joint_names=names, command=voltage, **fields)

    def event(self, machine: int, number: int, kind: int) -> None:
        """Send the state after a change by hand."""
        session = self._session
        self.send("/emulator/events", tick=session.tick, powered=session.powered, machine=machine,
                  number=number, kind=kind, state=array("B", session.plant.save()))  # fmt: skip


def synthetic(
    folder: Path,
    powers: list[bool],
    first: int = 0,
    runs: int = 2,
) -> Path:
    """A bag of some runs, made without a network, with the machine at 0 V before tick `first`."""
    session = Session(load_scene("three_axis"), "lockstep", "first_answer")
    names = list(session.scene.joint_names)
    rng = np.random.default_rng(7)
    with BagWriter(folder) as writer:
        sender = EmulatorBag(writer, session)
        for _ in range(runs):
            session.reset()
            session.powered = True
            sender.report()
            for powered in powers:
                if session.tick >= first:
                    voltage = rng.uniform(-5.0, 5.0, len(names)).tolist()
                    sender.command(session.tick + 1000, voltage)
                    sender.command(session.tick, voltage)
                    session.offer(session.tick, names, voltage)
                session.powered = powered
                session.advance()
                sender.report()
                sender.report()  # as an unanswered state is reported again
            # Underway when the reset comes: refused.
            sender.command(session.tick, [1.0] * 3)
    return folder
