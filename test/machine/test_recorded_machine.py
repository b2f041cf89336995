"""Recorded runs visited at any tick, and explained."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_bags import TYPES, EmulatorBag, synthetic
from sensor_msgs.msg import JointState

from arm_emulator import Kinematics, Refusal, Session, Timeline, load_scene
from arm_emulator.analysis.residual_vibration import measure_vibration
from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.cli.command_line import main
from arm_emulator.machine.plant.plant_state import compute_count_angle
from arm_emulator.ros.recording.bag import Bag
from arm_emulator.ros.recording.bag_writer import BagWriter

POWERS = [True] * 30 + [False] * 9 + [True] * 60


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return synthetic(tmp_path_factory.mktemp("bags") / "bag", POWERS, first=3)


@pytest.mark.parametrize("run", (1, 2, -1))
def test_any_tick_of_a_record_is_reached(bag: Path, run: int) -> None:
    scene = load_scene("three_axis")
    states = list[tuple[int, list[int]]]()
    runs = [states]
    for _, state in RecordedTopics(Bag(bag)).read_messages("motor_states"):
        if state.tick == 0 and states:
            states = []
            runs.append(states)
        if state.tick == len(states):
            states.append((int(state.tick), list(state.encoder_counts)))
    states = runs[run - 1 if run > 0 else -1]
    line = Timeline(RecordedMachine.open_run(bag, scene, run), every=16)
    assert line.run.last == len(POWERS) == len(states) - 1
    line.advance(line.run.last)
    rng = np.random.default_rng(1)
    for tick in rng.permutation(len(states)).tolist():
        line.go_to(tick)
        session = line.run.session
        assert (session.tick, list(session.measured.encoder_counts)) == states[tick]
    assert not POWERS[35 - 1], "without power"
    line.go_to(35)
    assert not line.run.session.powered
    with pytest.raises(Refusal, match="ticks must be"):
        line.run.advance(len(POWERS))


@pytest.mark.parametrize("run", (0, 3, 1.5, True))
def test_another_run_is_refused(bag: Path, run: int) -> None:
    with pytest.raises(Refusal, match="run must be"):
        RecordedMachine.open_run(bag, load_scene("three_axis"), run)


@pytest.fixture
def explain(
    bag: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Callable[[str], tuple[object, dict[str, Any]]]:
    """Exit code and JSON of `explain` at a time."""

    def call(at: str) -> tuple[object, dict[str, Any]]:
        monkeypatch.setattr("sys.argv", ["arm_emulator", "explain", str(bag), "--json", "--at", at])
        with pytest.raises(SystemExit) as end:
            main()
        return end.value.code, json.loads(capsys.readouterr().out)

    return call


Explain = Callable[[str], tuple[object, dict[str, Any]]]


def test_a_moment_is_explained(bag: Path, explain: Explain) -> None:
    machine = RecordedMachine.open_run(bag, load_scene("three_axis"))
    machine.advance(20)
    code, now = explain("0.02")
    assert code == 0
    names = machine.scene.joint_names
    assert now["tick"] == 20 and now["powered"] is True
    assert now["q"] == dict(zip(names, machine.session.state.q.tolist(), strict=True))
    applied = machine.ticks[21].applied[0].tolist()
    assert now["applied"] == now["commanded"] == dict(zip(names, applied, strict=True))
    links = now["torques_on_links"]
    for name in names:
        assert abs(sum(value[name] for value in links.values() if value[name] is not None)) < 1e-12
    dark = explain("0.035")[1]
    assert "the drives have no power" in dark["active"]
    assert not any(dark["applied"].values())
    last = explain(f"{len(POWERS) * 1e-3:g}")[1]
    assert last["applied"] is None


def test_the_first_moment_of_a_condition_is_explained(
    bag: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    machine = RecordedMachine.open_run(bag, load_scene("three_axis"))
    speeds = [0.0]
    while machine.tick < machine.last:
        machine.advance(1)
        speeds.append(float(np.abs(machine.session.state.v[1])))
    threshold = sorted(speeds)[60]
    at = 20
    for arguments, tick in (
        (["--when", f"abs(v.shoulder) > {threshold!r}"], np.argmax(np.array(speeds) > threshold)),
        (["--at", f"{at * 1e-3}", "--when", f"abs(v.shoulder) > {threshold!r}"],
         at + 1 + np.argmax(np.array(speeds[at + 1 :]) > threshold)),
        (["--when", "tick >= 0"], 0),
        (["--when", "tick > 1e6"], None),
    ):  # fmt: skip
        monkeypatch.setattr("sys.argv", ["arm_emulator", "explain", str(bag), "--json", *arguments])
        with pytest.raises(SystemExit) as end:
            main()
        facts = json.loads(capsys.readouterr().out)
        assert facts["tick"] == tick, arguments
        assert end.value.code == int(tick is None)
    monkeypatch.setattr("sys.argv", ["arm_emulator", "explain", str(bag)])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2 and "--at or --when must be given" in capsys.readouterr().err


@pytest.mark.parametrize("at", ("-1", "1e9", "nan", "0.0996"))
def test_a_moment_beyond_the_record_is_refused(at: str, explain: Explain) -> None:
    code, output = explain(at)
    assert code == 2
    assert "--at must be within the run, 0 to 0.099 s" in output["refused"]


def test_the_vibration_after_the_last_targets_is_that_of_the_machine(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Voltages for 200 ms, targets of 10 ms up to there; then the links swing on their gears."""
    session = Session(load_scene("three_axis"), "lockstep", "first_answer")
    names, places, counts = list(session.scene.joint_names), [], []
    tool = Kinematics(session.scene.urdf, names, session.scene.tool)
    count_angle = compute_count_angle(session.scene)
    kinds = {**TYPES, "/joint_targets": JointState}
    with BagWriter(tmp_path / "bag") as writer:
        bag = EmulatorBag(writer, session, kinds)
        for tick in range(600):
            bag.report()
            if tick % 10 == 0 and tick <= 190:
                bag.send("/joint_targets", name=names, position=[0.001 * tick, 0.0, 0.0])
            volts = [6.0, 0.0, 0.0] if tick < 190 else [0.0, 0.0, 0.0]
            places.append(tool.forward(session.state.q)[1])
            counts.append(tool.forward(count_angle * session.measured.encoder_counts)[1])
            bag.command(tick, volts)
            session.offer(tick, names, volts)
            session.advance()
    end = 200
    words = ["explain", str(tmp_path / "bag"), "--scene", "three_axis", "--json"]
    for more in ([], ["--at", "0.2"]):
        monkeypatch.setattr("sys.argv", ["arm_emulator", *words, "--stop", "0.05", *more])
        with pytest.raises(SystemExit) as code:
            main()
        report = json.loads(capsys.readouterr().out)
        assert code.value.code == 0 and report["tick"] == end, report
        for source, rows in (("truth", places), ("encoders", counts)):
            expected = measure_vibration(np.array(rows[end:]), 1e-3, 5e-5)
            for key in ("largest", "swing", "rms", "frequency", "settled"):
                value = getattr(expected, key)
                value = None if np.isnan(value) else pytest.approx(value, rel=1e-6, abs=1e-12)
                assert report[source][key] == value, (source, key)
