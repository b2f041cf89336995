"""A recorded run in Rerun: torques by term, limits, texts where something begins, targets."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from made_bags import synthetic
from rerun.chunk import RrdReader

from arm_emulator.analysis.torque_terms import TorqueTerms
from arm_emulator.bags.explanation import acting
from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.cli.commands.film import film, write_view
from arm_emulator.machine.scene import load_scene
from arm_emulator.motion.kinematics import Kinematics
from arm_emulator.ros.bag import Bag

LAST, BEGIN, END = 200, 40, 180  # ticks of 1 ms
SCENE = load_scene("three_axis")


def columns(file: Path) -> dict[str, list[tuple[int, object]]]:
    """Times [ns] and values of each entity."""
    found: dict[str, list[tuple[int, object]]] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for chunk in RrdReader(file).stream().filter(is_static=False):
            batch = chunk.to_record_batch()
            for name in ("Scalars:scalars", "TextLog:text"):
                if name in batch.schema.names:
                    times = batch.column("t").cast("int64").to_pylist()
                    values = [one[0] for one in batch.column(name).to_pylist()]
                    found.setdefault(str(chunk.entity_path), []).extend(
                        zip(times, values, strict=True)
                    )
    return {path: sorted(rows) for path, rows in found.items()}


def test_terms_limits_and_texts_are_those_of_the_run(tmp_path: Path) -> None:
    powers = [not 100 <= tick < 150 for tick in range(LAST)]
    bag, file = synthetic(tmp_path / "bag", powers, runs=1), tmp_path / "run.rrd"
    assert film(bag, file, begin=BEGIN * 1e-3, end=END * 1e-3) == 0
    seen = columns(file)
    machine, terms = RecordedMachine.of(bag, SCENE), TorqueTerms(SCENE)
    machine.advance(BEGIN)
    while True:
        now = terms.of(machine.session.plant.save(), acting(machine))
        index, time = machine.tick - BEGIN, machine.session.logical_ns
        sums = np.zeros(3)
        for name, row in now.link.items():
            path = f"/signals/{_escaped(f'on link: {name}')}"
            got = [seen[f"{path}/{joint}"][index] for joint in SCENE.joint_names]
            assert [one[0] for one in got] == [time] * 3
            np.testing.assert_array_equal([one[1] for one in got], row, err_msg=name)
            sums += np.array([one[1] for one in got], np.float64)
        # Terms cancel: what is left is rounding of the largest of them, some 100 N m.
        assert np.abs(sums).max() < 1e-9
        if machine.tick == END:
            break
        machine.advance(1)
    for joint, most in zip(SCENE.joint_names, SCENE.largest_commands, strict=True):
        for side, sign in (("least", -1), ("most", 1)):
            path = f"/limits/applied/{joint}{_escaped(f', {side}')}"
            assert {value for _, value in seen[path]} == {sign * most}
    texts = [(time // 10**6, text) for time, text in seen["/events"]]
    # A machine that is driven again has the power of the period that ended.
    assert (101, "the drives have no power") in texts, texts
    assert (151, "no longer: the drives have no power") in texts, texts


@pytest.mark.parametrize("explained", [True, False])
def test_the_tool_is_shown_beside_the_targets_of_its_run(tmp_path: Path, explained: bool) -> None:
    p_WT, file = (0.3, -0.2, 0.5), tmp_path / "run.rrd"
    bag = synthetic(tmp_path / "bag", [True] * LAST, runs=2, p_WT=p_WT)
    machine, topics = RecordedMachine.of(bag, SCENE), RecordedTopics(Bag(bag))
    write_view(topics, machine, file, END, 1, explained=explained)
    seen = columns(file)
    kinematics = Kinematics(SCENE.urdf, SCENE.joint_names, SCENE.tool)
    q = np.array([
        [value for _, value in seen[f"/signals/q/{joint}"]] for joint in SCENE.joint_names
    ]).T  # fmt: skip
    p = np.array([kinematics.forward(one)[1] for one in q])
    for axis, target, at in zip("xyz", p_WT, p.T, strict=True):
        times, got = zip(*seen[f"/signals/tool_deviation/{axis}"], strict=True)
        # It is published behind the state of tick 0, and the arm is drawn 60 times a second.
        assert times == tuple(10**6 * -(-number * 1000 // 60) for number in range(1, 11))
        # Angles of the view are in single precision.
        np.testing.assert_allclose(got, target - at[np.array(times) // 10**6], atol=1e-6)


def test_without_targets_no_room_is_kept_for_them(tmp_path: Path) -> None:
    plotted = {}
    for name, p_WT in (("with", (0.3, -0.2, 0.5)), ("without", None)):
        bag = synthetic(tmp_path / name, [True] * 3, runs=1, p_WT=p_WT)
        file = tmp_path / f"{name}.rrd"
        write_view(
            RecordedTopics(Bag(bag)), RecordedMachine.of(bag, SCENE), file, 3, 1, explained=False
        )
        plotted[name] = b"Target minus tool" in file.read_bytes()
    assert plotted == {"with": True, "without": False}


def _escaped(text: str) -> str:
    """A part of an entity's path as Rerun writes it."""
    return "".join(one if one.isalnum() or one in "-_." else f"\\{one}" for one in text)
