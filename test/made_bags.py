"""Bags made without a network."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message
from std_msgs.msg import Header

from arm_emulator import Session, load_scene
from arm_emulator.ros.bag_metadata import Topic
from arm_emulator.ros.bag_writer import BagWriter
from arm_emulator.ros.message_types import definition_of
from arm_emulator.ros.node_shell import stamp
from arm_emulator_msgs.msg import MotorCommand, MotorState

TYPES = {"/motor_states": MotorState, "/motor_commands": MotorCommand}


class _Sender:
    """Writes what a network in lock-step sends, 1 us apart."""

    def __init__(self, writer: BagWriter, session: Session) -> None:
        kinds = {name: f"arm_emulator_msgs/msg/{one.__name__}" for name, one in TYPES.items()}
        self._numbers = {
            topic: writer.add_topic(Topic(topic, kind, definition_of(kind)))
            for topic, kind in kinds.items()
        }
        self._writer, self._session = writer, session
        self._names = list(session.scene.joint_names)
        self._clock = 10**18

    def send(self, topic: str, message: Any) -> None:
        self._clock += 1000
        data = serialize_message(message)
        self._writer.write(self._numbers[topic], self._clock, self._clock, data)

    def report(self) -> None:
        session = self._session
        state = MotorState(
            header=Header(stamp=stamp(session.logical_ns)),
            tick=session.tick,
            joint_names=self._names,
            powered=session.powered,
            encoder_counts=session.measured.encoder_counts,
            current=session.state.current,
            applied=session.measured.applied,
        )
        self.send("/motor_states", state)

    def command(self, tick: int, voltage: list[float]) -> None:
        message = MotorCommand(tick=tick, joint_names=self._names, command=voltage)
        self.send("/motor_commands", message)


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
        sender = _Sender(writer, session)
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
