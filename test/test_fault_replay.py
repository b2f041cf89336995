"""Random faults in recorded runs: `check-bag` drives each again to equal bits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from draws import FULL
from made_bags import EmulatorBag
from test_faults import whole_scene

from arm_emulator.bags.comparison import compare
from arm_emulator.machine.faults.known import FAULTS
from arm_emulator.machine.session.session import Session
from arm_emulator.ros.bag_writer import BagWriter
from arm_emulator_msgs.msg import MachineEvent, MotorCommand, MotorState

RUNS, TICKS = (400, 60) if FULL else ((len(FAULTS) + 1) // 2, 40)  # two kinds in a run
KINDS = {
    "/motor_states": MotorState,
    "/motor_commands": MotorCommand,
    "/emulator/events": MachineEvent,
}


def every_kind_first(session: Session, rng: np.random.Generator) -> list[int]:
    """The scene's faults in a random order, but one of each kind before all others."""
    kinds = [fault.kind.name for fault in session.scene.faults]
    order: list[int] = rng.permutation(len(kinds)).tolist()
    first = {kinds[place]: place for place in order}.values()
    return [*first, *(place for place in order if place not in first)]


def record(folder: Path, session: Session, rng: np.random.Generator) -> set[str]:
    """Write runs with two faults each, one of which ends; return the kinds of faults."""
    names, observed = list(session.scene.joint_names), set()
    order = every_kind_first(session, rng)
    fresh = session.plant.save()
    with BagWriter(folder) as writer:
        bag = EmulatorBag(writer, session, KINDS)
        for run in range(RUNS):
            session.reset()
            session.restore(fresh)
            faults = [session.scene.faults[order[(2 * run + k) % len(order)]] for k in range(2)]
            begins, ends = sorted(rng.integers(1, TICKS, 2))
            bag.report(run + 1)
            number = 0
            for tick in range(TICKS):
                for when, (fault, size) in ((begins, (faults[0], 1.0)), (begins, (faults[1], 0.7)),
                                          (ends, (faults[0], 0.0))):  # fmt: skip
                    if tick == when:
                        session.set_varied(fault.varied.name, size * fault.varied.number.default)
                        observed.add(fault.kind.name)
                        number += 1
                        bag.event(run + 1, number, MachineEvent.KIND_SET_VARIED)
                command = (np.array([15.0, 10.0, 1.0]) * rng.uniform(-1.0, 1.0, 3)).tolist()
                bag.command(tick, command, input_names=["command_d"], inputs=[0.0] * len(names))
                session.offer(tick, names, command)
                session.advance()
                bag.report(run + 1)
    return observed


def test_random_faults_are_repeated_to_equal_bits(tmp_path: Path) -> None:
    file = tmp_path / "scene"
    file.mkdir()
    session = Session(whole_scene(file), "lockstep", "first_answer")
    observed = record(tmp_path / "bag", session, np.random.default_rng(5))
    result = compare(tmp_path / "bag", str(file / "scene.yaml"))
    assert result.difference is None, result.difference
    assert result.tally.states == RUNS * (TICKS + 1) and result.tally.changes == 3 * RUNS
    assert observed == {fault.kind.name for fault in session.scene.faults}, "every kind"
