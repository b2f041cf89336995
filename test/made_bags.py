"""Bags made without a network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseStamped
from rclpy.serialization import serialize_message
from std_msgs.msg import Header

from arm_emulator import Session, load_scene
from arm_emulator.ros.bag_metadata import Topic
from arm_emulator.ros.bag_writer import BagWriter
from arm_emulator.ros.message_types import definition_of
from arm_emulator.ros.node_shell import stamp
from arm_emulator_msgs.msg import MotorCommand, MotorState

TYPES = {"/motor_states": MotorState, "/motor_commands": MotorCommand}


def synthetic(
    folder: Path,
    powers: list[bool],
    first: int = 0,
    runs: int = 2,
    p_WT: Sequence[float] | None = None,
) -> Path:
    """A bag of some runs, made without a network, with the machine at 0 V before tick `first`.

    At the start of each run p_WT, if given, is sent as a target of the tool.
    """
    session = Session(load_scene("three_axis"), "lockstep", "first_answer")
    names = list(session.scene.joint_names)
    rng = np.random.default_rng(7)
    clock = 10**18
    with BagWriter(folder) as writer:
        numbers = {
            topic: writer.add_topic(Topic(topic, kind, definition_of(kind)))
            for topic, kind in (
                *((name, f"arm_emulator_msgs/msg/{one.__name__}") for name, one in TYPES.items()),
                ("/tool_target", "geometry_msgs/msg/PoseStamped"),
            )
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
            if p_WT is not None:
                x, y, z = p_WT
                send("/tool_target", PoseStamped(pose=Pose(position=Point(x=x, y=y, z=z))))
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
