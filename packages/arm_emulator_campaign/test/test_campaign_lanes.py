"""Runs of a campaign side by side: each equals its single run, whatever runs are beside it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import FULL, some
from test_campaign import MOVES, TABLE, changed, written

from arm_emulator import ExternalWrench, Refusal, load_gains
from arm_emulator.machine.session.change import Change, NumberChange, PowerChange, WrenchChange
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.simulation.batch_simulator import WIDTH, BatchSimulator, make_simulator
from arm_emulator_campaign.simulation.case import Cases, draw_cases
from arm_emulator_campaign.simulation.outcome import Outcomes
from arm_emulator_campaign.simulation.simulator import Simulator
from arm_emulator_fleet import Fleet, ServoFleet
from arm_emulator_fleet.fleet_schedule import FleetWay

CHECKS = "def margin(trace):\n    return 2.0 - abs(trace['v.waist']).max() + trace['t'][-1]\n"
TARGETS = "t,elbow,waist,shoulder\n0.01,0.9,0.1,0.6\n0.05,0.8,0.2,0.5\n0.1,0.9,0.3,0.6\n"
JUDGED: dict[str, Any] = {
    "requirements": {
        "near": "always abs(error.*) < 0.3",
        "returns": "eventually[0.05, 0.15] always[0, 0.01] abs(v.elbow) < 0.05",
        "python": {"python": "checks.py:margin", "signals": ["v.*"]},
    },
    "measures": {
        "error": "max(abs(error.elbow))",
        "z": "max(tool.z)",
        "gear": "rms(gear_torque.*)",
        "current": "mean(measured.current.elbow)",
        "counts": "last(measured.encoder_counts.*)",
        "q": "last(q.elbow)",
        "energy": "min(energy)",
        "target": "last(target.elbow)",
    },
}
VARIED = {
    "all that varies": {},
    "a run's length and its start": {
        "vary": {
            "scenario.seconds": "uniform(0.05, 0.3)",
            "scenario.start.waist": "uniform(-1, 1)",
            "scenario.targets.1.at": "uniform(0.06, 0.1)",
        },
        "scenario": {
            "seconds": 0.2,
            "start": {"waist": 0.1},
            "targets": [{"at": 0.03, "elbow": 0.9}, {"at": 0.08, "waist": 0.3}],
        },
    },
    "faults over each other": {
        "vary": {"faults.drop.mass": "uniform(0, 1)", "payload.mass": "uniform(0, 3)"},
        "faults": {
            "drop": {"kind": "payload", "at": 0.02, "lasting": 0.1, "mass": 0.2},
            "more": {"kind": "payload", "at": 0.05, "lasting": 0.02, "mass": 2.0},
            "hit": {"kind": "impulse", "at": 0.05, "link": "tool", "impulse": [0.1, 0.2, 0.3]},
            "cut": {"kind": "power_cut", "at": 0.16},
        },
    },
    "a table of targets": {
        "scenario": {"seconds": 0.2, "table": "targets.csv"},
        "vary": {"payload.mass": "uniform(0, 3)"},
    },
    "a gear with play, without lanes": {
        "set": {"payload": 1.0, "joints.elbow.gear.backlash": 0.002},
    },
    "noise and lost commands": {
        "set": {
            "payload": 1.0,
            "joints.elbow.current_sensor": {"noise": 0.05},
            "faults": ["elbow.command_lost"],
        },
        "vary": {"joints.elbow.friction.viscous": "uniform(0.5, 5)"},
        "faults": {
            "lost": {"kind": "machine", "at": 0.04, "fault": "elbow.command_lost", "magnitude": 0.4}
        },
    },
}


def campaign_of(folder: Path, change: dict[str, Any]) -> Campaign:
    (folder / "checks.py").write_text(CHECKS)
    (folder / "targets.csv").write_text(TARGETS)
    return load_campaign(written(folder, TABLE | JUDGED | change))


def cases_of(campaign: Campaign, indices: Any) -> Cases:
    return draw_cases(campaign.variation, np.array(indices))


def rows_of(outcomes: Outcomes) -> np.ndarray:
    return np.hstack([outcomes.robustness, outcomes.measures, outcomes.diverged[:, None]])


@pytest.mark.parametrize("name", some(VARIED, 2))
def test_each_run_equals_its_single_run_whatever_is_beside_it(tmp_path: Path, name: str) -> None:
    campaign = campaign_of(tmp_path, VARIED[name])
    runs, alone = make_simulator(campaign), Simulator(campaign)
    assert isinstance(runs, BatchSimulator)
    count = WIDTH + 5
    all_rows = rows_of(
        Outcomes.join_outcomes(list(runs.simulate_runs(cases_of(campaign, range(count)))))
    )
    assert len(np.unique(all_rows, axis=0)) == count
    for index in some(range(count), 6):
        outcome = alone.simulate_run(index)
        single = [*outcome.robustness.values(), *outcome.measures.values(), outcome.diverged]
        np.testing.assert_array_equal(all_rows[index], single, err_msg=f"run {index}")
    order = np.random.default_rng(1).permutation(count)
    again = rows_of(Outcomes.join_outcomes(list(runs.simulate_runs(cases_of(campaign, order)))))
    assert np.array_equal(again, all_rows[order], equal_nan=True)
    few = rows_of(next(runs.simulate_runs(cases_of(campaign, order[:3]))))
    assert np.array_equal(few, all_rows[order[:3]], equal_nan=True)


@pytest.mark.skipif(not FULL, reason="lanes are compiled once more for it: make test-in-full")
def test_arms_that_stick_and_varied_gains_alike(tmp_path: Path) -> None:
    data = changed(TABLE | JUDGED, "set", {
        "payload": 1.0,
        "integrator.events": "located",
        "joints.*.friction.coulomb": 2.0,
    })  # fmt: skip
    (tmp_path / "checks.py").write_text(CHECKS)
    data["vary"] |= {"joints.*.friction.coulomb": "uniform(0.5, 4)"}
    campaign = load_campaign(written(tmp_path, data))
    runs, alone = make_simulator(campaign), Simulator(campaign)
    all_rows = rows_of(next(runs.simulate_runs(cases_of(campaign, range(12)))))
    for index in (0, 5, 11):
        outcome = alone.simulate_run(index)
        single = [*outcome.robustness.values(), *outcome.measures.values(), outcome.diverged]
        np.testing.assert_array_equal(all_rows[index], single, err_msg=f"run {index}")


@pytest.mark.skipif(not FULL, reason="FULL=1: another scene")
def test_a_run_that_diverges_does_not_disturb_the_others(tmp_path: Path) -> None:
    data = changed(TABLE, "vary", {"joints.elbow.gear.stiffness": "choice(1e4, 1e9)"})
    data = changed(changed(data, "faults", None), "set", {"integrator.scheme": "paper"})
    campaign = load_campaign(written(tmp_path, data))
    (outcomes,) = make_simulator(campaign).simulate_runs(cases_of(campaign, range(12)))
    alone = Simulator(campaign)
    for index, diverged in enumerate(outcomes.diverged):
        outcome = alone.simulate_run(index)
        assert outcome.has_failed == outcomes.failed[index]
        assert np.array_equal(outcome.diverged, diverged, equal_nan=True)
        rest = [*outcome.robustness.values()]
        np.testing.assert_array_equal(outcomes.robustness[index], rest)
    assert 0 < np.count_nonzero(outcomes.diverged > 0) < 12


def test_a_run_that_is_refused_leaves_those_before_it(tmp_path: Path) -> None:
    data = changed(TABLE, "vary/payload.mass", "normal(1, 1)")
    campaign = load_campaign(written(tmp_path, data))
    outcomes: list[Outcomes] = []
    reason = r"c.yaml, run \d+: payload.mass must be a number >= 0 kg"
    with pytest.raises(Refusal, match=reason) as no:
        for run in make_simulator(campaign).simulate_runs(cases_of(campaign, range(200))):
            outcomes.append(run)
    refused = int(str(no.value).partition("run ")[2].partition(":")[0])
    assert [*Outcomes.join_outcomes(outcomes).indices] == list(range(refused)) and refused > 0


def test_the_motion_controller_leads_runs_in_sequence(tmp_path: Path) -> None:
    campaign = load_campaign(written(tmp_path, MOVES))
    runs = make_simulator(campaign)
    assert isinstance(runs, Simulator)
    (outcomes,) = runs.simulate_runs(cases_of(campaign, [3]))
    assert outcomes.robustness[0, 0] == runs.simulate_run(3).robustness["near"]


# ----------------------------------------------------------------------------- the fleet by itself


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Fleet:
    campaign = load_campaign(written(tmp_path_factory.mktemp("fleet"), TABLE))
    return Fleet(campaign.scene, 2, workers=1)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ([[]], "changes must be a list for each of 2 arms"),
        ([[], [(3, PowerChange(False)), (2, PowerChange(True))]], "ticks must ascend from 0"),
        ([[(-1, PowerChange(False))], []], "ticks must ascend from 0"),
        ([[(2.7, PowerChange(False))], []], "tick must be a whole number"),
        ([[(0, PowerChange(1))], []], "power must be True or False"),
        ([[(0, "off")], []], "change must be a NumberChange, WrenchChange or PowerChange"),
        (None, "changes must be a list for each of 2 arms"),
        ([[(0, NumberChange("payload.mass", -1.0))], []], "payload.mass must be a number >= 0"),
        ([[(0, NumberChange("payload.mess", 1.0))], []], "name must be varied in the scene"),
        ([[(0, WrenchChange("hand", ExternalWrench()))], []], "link must be one that moves"),
    ],
)
def test_changes_that_make_no_sense_are_refused(
    fleet: Fleet, changes: list[list[tuple[int, Change]]], reason: str
) -> None:
    with pytest.raises(Refusal, match=reason):
        FleetWay(fleet.scene, 2).set_changes(changes)


def test_a_schedule_and_targets_of_a_different_fleet_are_refused(fleet: Fleet) -> None:
    servos = ServoFleet(fleet, load_gains("three_axis").servo)
    with pytest.raises(Refusal, match="way must be a FleetWay for this fleet"):
        fleet.follow(servos, 1, way=FleetWay(fleet.scene, 3))
    with pytest.raises(Refusal, match="arms must be"):
        fleet.follow(servos, 1, arms=3)
    with pytest.raises(Refusal, match="rows must have shape"):
        fleet.set_parameters(np.zeros((2, 2)))
    with pytest.raises(Refusal, match="arm 1: parameter must be within its bounds"):
        fleet.set_parameters(np.array([[1.0], [-1.0]]))
    assert fleet.parameters["payload.mass"].tolist() == [1.0, 1.0]
    q = np.zeros((3, 3))
    for since, first, reason in (
        ([0, 5, 5], [0, 1, 3], "since must ascend from 0"),
        ([0, 0, 5], [0, 3, 3], "since must ascend from 0"),
        ([0, 0, 5], [0, 1, 2], "first must be 3 places from 0 to 3"),
    ):
        with pytest.raises(Refusal, match=reason):
            servos.aim_at(since, q, first)
    with pytest.raises(Refusal, match="q must"):
        servos.aim_at([0, 0], q, [0, 1, 2])


def test_only_the_first_arms_advance_where_that_is_requested(fleet: Fleet) -> None:
    many = Fleet(fleet.scene, fleet.lanes + 3, workers=1)
    servos = ServoFleet(many, load_gains("three_axis").servo)
    many.follow(servos, 7, arms=1)
    assert many.state.t == pytest.approx([0.007] * fleet.lanes + [0.0] * 3)
