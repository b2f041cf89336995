"""Random faults in recorded runs: `check-bag` drives each again to equal bits."""

from __future__ import annotations

from array import array
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import FULL
from rclpy.serialization import serialize_message
from std_msgs.msg import Header
from test_faults import whole_scene

from arm_emulator.bags.comparison import compare
from arm_emulator.machine.faults.known import FAULTS
from arm_emulator.machine.plant.measured_fields import MeasuredFields
from arm_emulator.machine.session.session import Session
from arm_emulator.ros.bag_metadata import Topic
from arm_emulator.ros.bag_writer import BagWriter
from arm_emulator.ros.message_types import definition_of
from arm_emulator.ros.node_shell import stamp
from arm_emulator_msgs.msg import MachineEvent, MotorCommand, MotorState

RUNS, TICKS = (400, 60) if FULL else ((len(FAULTS) + 1) // 2, 40)  # two kinds in a run
KINDS = {
    "/motor_states": MotorState,
    "/motor_commands": MotorCommand,
    "/emulator/events": MachineEvent,
}


class Recorded:
    """A bag that is written as the nodes write it, a machine for each run."""

    def __init__(self, writer: BagWriter, session: Session) -> None:
        self._writer, self._session, self._clock = writer, session, 10**18
        types = [f"arm_emulator_msgs/msg/{kind.__name__}" for kind in KINDS.values()]
        self._numbers = {
            topic: writer.add_topic(Topic(topic, kind, definition_of(kind)))
            for topic, kind in zip(KINDS, types, strict=True)
        }
        self._fields = MeasuredFields(session.scene, MotorState.get_fields_and_field_types())

    def send(self, topic: str, **fields: Any) -> None:
        self._clock += 1000
        header = {"header": Header(stamp=stamp(self._session.logical_ns))}
        message = KINDS[topic](**fields, **(header if topic != "/motor_commands" else {}))
        if topic == "/motor_states":
            self._fields.begin(message, self._session.measured)
        data = serialize_message(message)
        self._writer.write(self._numbers[topic], self._clock, self._clock, data)

    def state(self, machine: int) -> None:
        session = self._session
        self.send("/motor_states", tick=session.tick, powered=session.powered, machine=machine,
                  joint_names=list(session.scene.joint_names),
                  imu_names=[one.name for one in session.scene.imus])  # fmt: skip

    def event(self, machine: int, number: int) -> None:
        session = self._session
        self.send("/emulator/events", tick=session.tick, powered=session.powered, machine=machine,
                  number=number, kind=MachineEvent.KIND_SET_VARIED,
                  state=array("B", session.plant.save()))  # fmt: skip


def every_kind_first(session: Session, rng: np.random.Generator) -> list[int]:
    """The scene's faults in a random order, but one of each kind before all others."""
    kinds = [fault.kind.name for fault in session.scene.faults]
    order: list[int] = rng.permutation(len(kinds)).tolist()
    first = {kinds[place]: place for place in order}.values()
    return [*first, *(place for place in order if place not in first)]


def record(folder: Path, session: Session, rng: np.random.Generator) -> set[str]:
    """Write runs with two faults each, one of which ends; return the kinds of faults."""
    names, seen = list(session.scene.joint_names), set()
    order = every_kind_first(session, rng)
    fresh = session.plant.save()
    with BagWriter(folder) as writer:
        bag = Recorded(writer, session)
        for run in range(RUNS):
            session.reset()
            session.restore(fresh)
            faults = [session.scene.faults[order[(2 * run + k) % len(order)]] for k in range(2)]
            begins, ends = sorted(rng.integers(1, TICKS, 2))
            bag.state(run + 1)
            number = 0
            for tick in range(TICKS):
                for when, (one, size) in ((begins, (faults[0], 1.0)), (begins, (faults[1], 0.7)),
                                          (ends, (faults[0], 0.0))):  # fmt: skip
                    if tick == when:
                        session.set_varied(one.varied.name, size * one.varied.number.default)
                        seen.add(one.kind.name)
                        bag.event(run + 1, number := number + 1)
                command = (np.array([15.0, 10.0, 1.0]) * rng.uniform(-1.0, 1.0, 3)).tolist()
                bag.send("/motor_commands", tick=tick, joint_names=names, command=command,
                         input_names=["command_d"], inputs=[0.0] * len(names))  # fmt: skip
                session.offer(tick, names, command)
                session.advance()
                bag.state(run + 1)
    return seen


def test_random_faults_are_repeated_to_equal_bits(tmp_path: Path) -> None:
    file = tmp_path / "scene"
    file.mkdir()
    session = Session(whole_scene(file), "lockstep", "first_answer")
    seen = record(tmp_path / "bag", session, np.random.default_rng(5))
    found = compare(tmp_path / "bag", str(file / "scene.yaml"))
    assert found.difference is None, found.difference
    assert found.tally.states == RUNS * (TICKS + 1) and found.tally.changes == 3 * RUNS
    assert seen == {fault.kind.name for fault in session.scene.faults}, "every kind"


def test_a_fault_that_is_not_recorded_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (file := tmp_path / "scene").mkdir()
    session = Session(whole_scene(file), "lockstep", "first_answer")
    plain = Recorded.event

    def spoiled(self: Recorded, machine: int, number: int) -> None:
        plain(self, machine, number)
        if (machine, number) == (2, 3):
            session.set_varied("faults.shoulder.encoder_slips", 0.3)

    monkeypatch.setattr(Recorded, "event", spoiled)
    monkeypatch.setattr("test_fault_replay.RUNS", 3)
    record(tmp_path / "bag", session, np.random.default_rng(6))
    found = compare(tmp_path / "bag", str(file / "scene.yaml"))
    assert found.difference is not None and found.difference.startswith("run 2, tick ")
