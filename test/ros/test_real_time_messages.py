"""Real time: commands that C takes are those that Python would, and what C publishes repeats."""

import random
from typing import Any

import numpy as np
import pytest
from by_hand import go_on
from draws import some, with_slow
from in_process import InProcess, in_process

from arm_emulator.base.validation.bound import COMMAND
from arm_emulator.ros.node.duplicate_nodes import get_start_time
from arm_emulator_msgs.msg import MotorCommand

JOINTS = ["waist", "shoulder", "elbow"]


def session_of(nodes: InProcess) -> Any:
    return nodes.nodes["emulator"]._session


def draw_message(draw: random.Random, answered: int, newest: int) -> MotorCommand:
    """A command that is due, or spoiled in one way."""
    spoil = draw.choice(["", "", "nan", "inf", "large", "stale", "same", "future", "machine"])
    numbers = [draw.uniform(-3.0, 3.0) for _ in JOINTS]
    bad = {"nan": np.nan, "inf": -np.inf, "large": 2.0 * float(COMMAND.most)}
    if spoil in bad:
        numbers[draw.randrange(3)] = bad[spoil]
    ticks = {"stale": max(0, answered - 1), "same": max(0, answered), "future": newest + 10**6}
    tick = ticks.get(spoil, draw.randint(answered + 1, newest))
    machine_number = (
        get_start_time() + 1 if spoil == "machine" else draw.choice([0, get_start_time()])
    )
    names = draw.sample(JOINTS, 3) if draw.random() < 0.1 else JOINTS
    return MotorCommand(joint_names=names, command=numbers, tick=tick, machine=machine_number)


def is_due(command: MotorCommand, answered: int, newest: int) -> bool:
    within = all(abs(voltage) <= COMMAND.most for voltage in command.command)  # false of a NaN
    return (
        within and answered <= command.tick <= newest and command.machine in (0, get_start_time())
    )


@pytest.mark.parametrize("seed", with_slow(some(range(8), 2), 1))
def test_only_commands_that_are_due_are_in_force(seed: int) -> None:
    """By the rules of docs/concepts/time.md, whichever of C and Python takes them."""
    draw, taken_in_c = random.Random(seed), 0
    with in_process("realtime") as nodes:
        done = nodes.take_in_c("emulator")
        session, look = session_of(nodes), nodes.nodes["emulator"]._pacer.check_time
        go_on(nodes, 20, look)
        for _ in range(200):
            while session.tick <= session.command_buffer.tick + 2:
                go_on(nodes, 1, look)
            answered, newest, refused = (
                session.command_buffer.tick, session.tick, nodes.refused("emulator"),
            )  # fmt: skip
            command_before, in_c = session.zoh_rows[0].tolist(), done[0]
            command = draw_message(draw, answered, newest)
            nodes.send("motor_commands", command)
            if is_due(command, answered, newest):
                place = dict(zip(command.joint_names, command.command, strict=True))
                assert session.zoh_rows[0].tolist() == [place[name] for name in JOINTS]
                assert session.command_buffer.tick == command.tick
                taken_in_c += done[0] - in_c
            elif command.tick <= newest:  # later ones: time has gone on since
                assert session.zoh_rows[0].tolist() == command_before
                assert session.command_buffer.tick == answered
                assert done[0] == in_c
                elsewhere = command.machine not in (0, get_start_time())
                assert nodes.refused("emulator") == refused + (not elsewhere)
    assert taken_in_c > 2, "C takes those in the form of the ones before"
