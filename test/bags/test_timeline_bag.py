"""Forks written as bags: check-bag repeats each, its metadata name the parent."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from arm_emulator import OfflineRun, Pose, Refusal, Session, Timeline
from arm_emulator.bags.comparison import compare_bag
from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.bags.timeline_bag import write_timeline
from arm_emulator.cli.command_line import main
from arm_emulator.machine.plant.plant_state import SET
from arm_emulator.ros.recording.bag import Bag
from arm_emulator.ros.recording.bag_metadata import FORKED_AT, PARENT
from arm_emulator.runs.offline import load_offline_run
from arm_emulator_analysis.first_difference import find_first_difference


def move(run: OfflineRun, y: float) -> None:
    R_WT, p_WT = run.controller.kinematics.forward(run.session.state.q)
    run.instructor.add(run.session.logical_ns, Pose(p_WT + np.array([0.0, y, 0.0]), R_WT))


def push(run: OfflineRun) -> None:
    rows = {"omega_m": (run.session.state.omega_m + 0.1).tolist()}
    run.session.set_state(run.session.scene.joint_names, rows)


def cut(run: OfflineRun, on: bool) -> None:
    run.session.powered = on


def rows(session: Session) -> list[bytes]:
    """The true state; a saved machine also holds the command of the period to come."""
    return [getattr(session.state, name).tobytes() for name in (*SET, "gear_torque")]


@pytest.mark.slow
def test_forks_of_forks_are_bags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                 capsys: pytest.CaptureFixture[str]) -> None:  # fmt: skip
    line = Timeline(load_offline_run("three_axis"), every=64)
    line.change("pushed at first", push)
    line.change("target", partial(move, y=0.05))
    line.advance(150)
    line.change("pushed", push)
    line.advance(150)
    line.go_to(90)
    fork = line.fork()
    fork.change("other target", partial(move, y=-0.04))
    fork.advance(110)
    fork.change("power off", partial(cut, on=False))
    fork.advance(40)
    fork.change("power on", partial(cut, on=True))
    fork.advance(30)
    fork.go_to(210)
    second = fork.fork()
    second.change("pushed", push)
    second.advance(64)
    lines = {"first": line, "fork": fork, "second": second}
    parents = {"fork": "first", "second": "fork"}
    expected = {}
    for name, branch in lines.items():
        at = branch.tick
        write_timeline(
            branch, tmp_path / name, tmp_path / parents[name] if name in parents else None
        )
        assert branch.tick == at
        branch.go_to(branch.newest)
        expected[name] = rows(branch.run.session)
    for name, branch in lines.items():
        comparison = compare_bag(tmp_path / name)
        assert comparison.difference is None
        assert comparison.tally.states == branch.newest + 1
        about = Bag(tmp_path / name).about
        assert about.get(PARENT) == (str(tmp_path / parents[name]) if name in parents else None)
        if name in parents:
            assert about[FORKED_AT] == str(branch.begins)
        machine = RecordedMachine.open_run(tmp_path / name)
        machine.advance(machine.last)
        assert rows(machine.session) == expected[name]
    # The parts before a fork are the same; from there on they differ.
    for name, parent in parents.items():
        sides = (RecordedMachine.open_run(tmp_path / folder) for folder in (parent, name))
        difference, equal = find_first_difference(*sides)
        assert difference is not None and lines[name].begins < equal + 1
    monkeypatch.setattr("sys.argv", ["arm_emulator", "check-bag", str(tmp_path / "second")])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 0
    assert f"forked from {tmp_path / 'fork'} at tick 210" in capsys.readouterr().out


def test_a_line_that_has_not_forked_is_refused(tmp_path: Path) -> None:
    run = load_offline_run("three_axis")
    line = Timeline(run)
    line.advance(3)
    with pytest.raises(Refusal, match="be a fork"):
        write_timeline(line, tmp_path / "bag", tmp_path / "parent")
    with pytest.raises(Refusal, match="must exist"):
        write_timeline(line.fork(), tmp_path / "bag", tmp_path / "parent")
    with pytest.raises(Refusal, match="begin at tick 0"):
        write_timeline(Timeline(run), tmp_path / "bag")
    assert not (tmp_path / "bag").exists()
    assert np.isfinite(run.session.state.q).all()
