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


def synthetic(folder: Path, powers: list[bool], first: int = 0, runs: int = 2) -> Path:
    """A bag of some runs, made without a network, with the machine at 0 V before tick `first`."""
    session = Session(load_scene("three_axis"), "lockstep", "first_answer")
    names = list(session.scene.joint_names)
    rng = np.random.default_rng(7)
    clock = 10**18
    with BagWriter(folder) as writer:
        numbers = {
            topic: writer.add_topic(
                Topic(
                    topic,
                    f"arm_emulator_msgs/msg/{kind.__name__}",
                    definition_of(f"arm_emulator_msgs/msg/{kind.__name__}"),
                )
            )
            for topic, kind in TYPES.items()
        }

        def send(topic: str, message: Any) -> None:
            nonlocal clock
            clock += 1000
            writer.write(numbers[topic], clock, clock, serialize_message(message))

        def report() -> None:
            send(
                "/motor_states",
                MotorState(
                    header=Header(stamp=stamp(session.logical_ns)),
                    tick=session.tick,
                    joint_names=names,
                    powered=session.powered,
                    encoder_counts=session.measured.encoder_counts,
                    current=session.state.current,
                    applied=session.measured.applied,
                ),
            )

        for _ in range(runs):
            session.reset()
            session.powered = True
            report()
            for powered in powers:
                if session.tick >= first:
                    voltage = rng.uniform(-5.0, 5.0, len(names)).tolist()
                    send(
                        "/motor_commands",
                        MotorCommand(tick=session.tick + 1000, joint_names=names, command=voltage),
                    )
                    send(
                        "/motor_commands",
                        MotorCommand(tick=session.tick, joint_names=names, command=voltage),
                    )
                    session.offer(session.tick, names, voltage)
                session.powered = powered
                session.advance()
                report()
                report()  # as an unanswered state is reported again
            # Underway when the reset comes: refused.
            send(
                "/motor_commands",
                MotorCommand(tick=session.tick, joint_names=names, command=[1.0] * 3),
            )
    return folder
