"""Runs that are drawn and bound in arrays, against each alone by its file and its session."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some
from test_campaign import changed
from test_campaign_lanes import VARIED, campaign_of

from arm_emulator import Refusal
from arm_emulator.machine.plant.external_wrench import move_to_moving_link
from arm_emulator.machine.session.change import Change, NumberChange, WrenchChange
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.sampling.philox import draw_uniform
from arm_emulator_campaign.simulation.batch_simulator import BatchSimulator
from arm_emulator_campaign.simulation.bound_cases import bind_cases
from arm_emulator_campaign.simulation.case import Cases, draw_cases
from arm_emulator_campaign.simulation.change_rows import KINDS
from arm_emulator_campaign.simulation.simulator import bind_case
from arm_emulator_fleet.unit import FLEET

COUNT = 60
DRAWN: dict[str, dict[str, Any]] = {
    "faults over each other, in any order": {
        "vary": {
            "payload.mass": "uniform(0, 3)",
            **{f"faults.{name}.at": "uniform(0, 0.19)" for name in ("drop", "more", "hit", "push")},
            **{f"faults.{name}.lasting": "uniform(0.001, 0.1)" for name in ("drop", "more")},
            "faults.third.at": "choice(0.02, 0.05, 0.1)",
            "faults.third.lasting": "choice(0.01, 0.05, 0.1)",
            "faults.hit.lasting": "uniform(0.001, 0.02)",
            "faults.hit.impulse.1": "normal(0, 0.2)",
            "faults.push.force.0": "normal(0, 50)",
            "faults.push.point.1": "normal(0, 0.05)",
        },
        "faults": {
            "drop": {"kind": "payload", "at": 0.02, "lasting": 0.1, "mass": 0.2},
            "more": {"kind": "payload", "at": 0.05, "lasting": 0.02, "mass": 2.0},
            "third": {"kind": "payload", "at": 0.05, "lasting": 0.02, "mass": 1.0},
            "hit": {"kind": "impulse", "at": 0.05, "lasting": 0.01, "link": "tool",
                    "impulse": [0.1, 0.2, 0.3]},
            "push": {"kind": "wrench", "at": 0.05, "lasting": 0.05, "link": "tool", "axes": "link",
                     "force": [1, 2, 3], "point": [0.01, 0.02, 0.03]},
            "cut": {"kind": "power_cut", "at": 0.16, "lasting": 0.01},
        },
    },
    "targets that hold on from the start": {
        "vary": {
            "scenario.seconds": "uniform(0.05, 0.3)",
            "scenario.start.waist": "uniform(-0.1, 0.1)",
            "scenario.targets.0.at": "choice(0, 0.001, 0.02)",
            "scenario.targets.1.at": "uniform(0.06, 0.1)",
            "scenario.targets.0.elbow": "uniform(0.85, 0.95)",
            "controller.joints.elbow.velocity_gain": "uniform(120, 180)",
        },
        "scenario": {
            "seconds": 0.2,
            "start": {"waist": 0.1},
            "targets": [{"at": 0.0, "elbow": 0.9}, {"at": 0.08, "shoulder": 0.6}],
        },
    },
    "no targets": {
        "vary": {"scenario.start.elbow": "uniform(0.6, 0.9)"},
        "scenario": {"seconds": 0.2, "start": {"elbow": 0.8}},
    },
}  # fmt: skip


def test_random_numbers_are_those_of_numpy() -> None:
    rng = np.random.default_rng(5)
    for count in range(1, 18):
        key = int.from_bytes(rng.bytes(16), "little")
        indices = rng.integers(0, 10**12, 7)
        for index, row in zip(indices.tolist(), draw_uniform(key, indices, count), strict=True):
            bits = np.random.Philox(counter=[0, 0, 0, index], key=key)
            np.testing.assert_array_equal(row, np.random.Generator(bits).random(count))


def list_changes(campaign: Campaign, changes: Any) -> list[tuple[Any, ...]]:
    """Return what a row of ``arm_fleet_change`` should have, for each change of a run."""
    places = [number.name for number in campaign.scene.varied]
    rows: list[tuple[Any, ...]] = []
    for tick, change in changes:
        row: tuple[Any, ...] = ("power", float(getattr(change, "on", 0.0)))
        if isinstance(change, NumberChange):
            row = places.index(change.name), change.value
        elif isinstance(change, WrenchChange):
            link, wrench = move_to_moving_link(campaign.scene, "", change.link, change.wrench)
            row = link, wrench.axes, *map(tuple, (wrench.force, wrench.moment, wrench.point))
        rows.append((tick, type(change), *row))
    return rows


def read_changes(rows: np.ndarray) -> list[tuple[Any, ...]]:
    """Return the same of the rows that the core gets."""
    kinds: dict[int, type[Change]] = {number: kind for kind, number in KINDS.items()}
    read: list[tuple[Any, ...]] = []
    for row in rows:
        kind = kinds[int(row["kind"])]
        what: tuple[Any, ...] = ("power", row["value"])
        if kind is NumberChange:
            what = int(row["place"]), row["value"]
        elif kind is WrenchChange:
            wrench = FLEET.ffi.cast("arm_wrench *", int(row["wrench"]))
            vectors = (tuple(getattr(wrench, name)) for name in ("force", "moment", "point"))
            what = int(row["place"]), ("link", "world")[wrench.axes], *vectors
        read.append((int(row["tick"]), kind, *what))
    return read


@pytest.mark.parametrize("name", some(DRAWN, 3) + some(VARIED, 2))
def test_many_runs_are_bound_as_each_alone(tmp_path: Path, name: str) -> None:
    campaign = campaign_of(tmp_path, (DRAWN | VARIED)[name])
    cases = draw_cases(campaign.variation, range(COUNT))
    bound, changes = bind_cases(campaign, cases), bind_cases(campaign, cases).changes
    period, orders = campaign.scene.servo_period, set()
    for run, case in enumerate(cases):
        alone = bind_case(campaign, case)
        read = read_changes(changes.rows[changes.first[run] : changes.first[run + 1]])
        assert read == list_changes(campaign, alone.changes)
        orders.add(tuple((kind, what) for _, kind, what, *_ in read))
        assert bound.last[run] == alone.last
        assert np.array_equal(bound.start[run % len(bound.start)], alone.scenario.start)
        assert bound.servos[run % len(bound.servos)] == alone.servo
        if bound.targets is not None:
            rows = slice(*bound.targets.first[run : run + 2])
            assert bound.targets.since[rows].tolist() == alone.scenario.table.compute_ticks(period)
            assert np.array_equal(bound.targets.q[rows], alone.scenario.table.q)
        own = {number.name: number.value for number in campaign.scene.varied} | dict(case.values)
        if campaign.scene.has_sensor_errors:
            own["seed"] = case.seed
        expected = [own[number.name] for number in campaign.scene.varied]
        assert bound.numbers[run].tolist() == expected
    assert len(orders) > 9 or "any order" not in name, "faults come in few orders"


def test_faults_that_do_not_happen_and_other_seeds(tmp_path: Path) -> None:
    campaign = campaign_of(tmp_path, VARIED["noise and lost commands"])
    sampled = draw_cases(campaign.variation, range(5))
    reseeds = ((10, 7.0), (40, 8.0))
    for without in (frozenset[str](), frozenset({"lost"})):
        cases = Cases(
            sampled.names, sampled.indices, sampled.values, sampled.seeds, without, 0.1, reseeds
        )
        bound = bind_cases(campaign, cases)
        for run, case in enumerate(cases):
            alone = bind_case(campaign, case)
            rows = bound.changes.rows[bound.changes.first[run] : bound.changes.first[run + 1]]
            assert read_changes(rows) == list_changes(campaign, alone.changes)
            assert bound.last[run] == alone.last == 100


@pytest.mark.parametrize(
    ("path", "text", "reason"),
    [
        ("vary/faults.more.mass", "normal(1, 1)", r"mass must be a number >= 0 kg"),
        ("vary/faults.hit.impulse.0", "normal(0, 600)", r"force must be"),
        ("vary/payload.mass", "normal(1, 1)", r"payload.mass must be a number >= 0 kg"),
    ],
)
def test_the_first_run_that_is_refused_alone_is_named(
    tmp_path: Path, path: str, text: str, reason: str
) -> None:
    data = changed(VARIED["faults over each other"], path, text)
    campaign = campaign_of(tmp_path, data)
    cases = draw_cases(campaign.variation, range(200))
    simulator = BatchSimulator(campaign)
    with pytest.raises(Refusal, match=rf"c.yaml, run \d+: .*{reason}") as no:
        for outcomes in simulator.simulate_runs(cases):
            last = int(outcomes.indices[-1])
    refused = int(str(no.value).partition("run ")[2].partition(":")[0])
    assert refused > 0 and last == refused - 1
    with pytest.raises(Refusal):
        bind_cases(campaign, cases[refused : refused + 1])
    bind_cases(campaign, cases[:refused])
