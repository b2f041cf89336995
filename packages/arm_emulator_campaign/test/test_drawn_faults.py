"""Faults whose numbers vary: set by their numbers, they are those that a file with these states."""

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.external_wrench import ExternalWrench
from arm_emulator.machine.session.change import Change, NumberChange, WrenchChange
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.definition.fault import Fault, list_faults, schedule_changes
from arm_emulator_campaign.definition.varying_numbers import list_leaves

FAULTS: dict[str, dict[str, Any]] = {
    "push": {"kind": "wrench", "at": 0.1, "lasting": 0.05, "link": "tool", "force": [1, 2, 3],
             "moment": [0, 0, 0.5], "point": [0, 0.1, 0]},
    "push.again": {"kind": "impulse", "at": 0.1, "link": "tool", "impulse": [0.1, 0, 0],
                   "lasting": 0.01},
    "slip": {"kind": "machine", "fault": "elbow.encoder_slips", "at": 0.1, "magnitude": 0.1},
    "drop": {"kind": "payload", "at": 0.1, "mass": 0.5},
    "stiff": {"kind": "number", "at": 0.1, "name": "joints.elbow.friction.viscous", "value": 4.0},
    "dark": {"kind": "power_cut", "at": 0.1, "lasting": 0.05},
}  # fmt: skip
SENT = {
    "scene": "three_axis",
    "set": {"faults": ["elbow.encoder_slips"], "payload": 1.0},
    "scenario": {"seconds": 0.2, "targets": [{"at": 0.0, "elbow": 1.0}]},
    "faults": FAULTS,
    "vary": {f"faults.{name}": "uniform(0, 1)" for name, _ in list_leaves(FAULTS)},
    "count": 20,
}


def loaded(folder: Path, faults: dict[str, Any]) -> Campaign:
    file = folder / "c.yaml"
    file.write_text(yaml.safe_dump({**SENT, "faults": faults}, sort_keys=False))
    return load_campaign(file)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    return loaded(tmp_path_factory.mktemp("drawn"), FAULTS)


def written(values: dict[str, float]) -> dict[str, Any]:
    """The section with these numbers in it."""
    faults = copy.deepcopy(FAULTS)
    for name, value in values.items():
        fault = max((fault for fault in faults if name.startswith(f"faults.{fault}.")), key=len)
        key, *place = name.removeprefix(f"faults.{fault}.").split(".")
        if place:
            faults[fault][key][int(place[0])] = value
        else:
            faults[fault][key] = value
    return faults


def test_every_kind_is_varied_here() -> None:
    assert {value["kind"] for value in FAULTS.values()} == set(list_faults())


@pytest.mark.parametrize("seed", range(8))
def test_varied_faults_are_those_of_a_file_with_their_numbers(
    campaign: Campaign, tmp_path: Path, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    names = [number.name for number in campaign.variation.numbers]
    some = rng.permutation(names)[: 1 + seed * len(names) // 7].tolist()
    values = {name: float(rng.uniform(0.02, 0.9)) for name in some}
    assert campaign._bind_numbers(values) is not None, "no section is read"
    assert campaign.bind_values(values)[1] == loaded(tmp_path, written(values)).nominal[1]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("faults.push.at", -1.0),
        ("faults.push.force.1", np.inf),
        ("faults.push.again.impulse.0", 1e12),
        ("faults.slip.magnitude", 1e8),  # beyond what this scene's fault takes
        ("faults.drop.mass", -0.1),
        ("faults.stiff.value", -0.1),
    ],
)
def test_a_draw_is_refused_as_a_file_is(
    campaign: Campaign, tmp_path: Path, name: str, value: float
) -> None:
    with pytest.raises(Refusal) as refused:
        campaign.bind_values({name: value})
    with pytest.raises(Refusal) as read:
        loaded(tmp_path, written({name: value}))
    assert str(refused.value) == str(read.value)


def test_numbers_of_faults_have_units(campaign: Campaign) -> None:
    units = {
        number.name.removeprefix("faults."): number.unit for number in campaign.variation.numbers
    }
    expected = {"push.force.2": "N", "push.moment.0": "N m", "push.point.1": "m", "push.at": "s",
                "push.again.impulse.0": "N s", "drop.mass": "kg", "slip.magnitude": ""}  # fmt: skip
    assert {name: units[name] for name in expected} == expected


ENDS = 40  # ticks, after which all faults have ended


def set_by(change: Change) -> tuple[str, Any]:
    if isinstance(change, NumberChange):
        return change.name, change.value
    if isinstance(change, WrenchChange):
        return change.link, change.wrench
    return "power", change.on


@pytest.mark.parametrize("seed", range(20))
def test_the_newest_fault_that_lasts_holds(campaign: Campaign, seed: int) -> None:
    """Faults that set the same, over each other in any way, against a look at every tick."""
    rng = np.random.default_rng(seed)
    period, nominal_faults = campaign.scene.servo_period, list(campaign.nominal[1].values())
    faults: list[tuple[Fault, int, int]] = []
    for _ in range(int(rng.integers(2, 7))):
        begins, ticks = int(rng.integers(0, 20)), int(rng.integers(1, 20))
        times = {"at": begins * period, "lasting": ticks * period}
        nominal_fault = nominal_faults[int(rng.integers(len(nominal_faults)))]
        size = {"payload": "mass", "machine": "magnitude", "number": "value"}.get(
            nominal_fault.kind
        )
        more = {} if size is None else {size: float(rng.uniform(0.1, 2.0))}
        varied_fault = nominal_fault.replace_numbers(
            [((key,), value) for key, value in {**times, **more}.items()]
        )
        assert varied_fault is not None
        faults.append((varied_fault, begins, begins + ticks))
    changes = schedule_changes(
        [fault for fault, *_ in faults], campaign.scene, {"payload.mass": 1.5}
    )
    assert [tick for tick, _ in changes] == sorted(tick for tick, _ in changes)
    sound: dict[str, Any] = {number.name: number.value for number in campaign.scene.varied}
    sound |= {"payload.mass": 1.5, "power": True}
    now = dict(sound)
    for tick in range(ENDS):
        now |= dict(set_by(change) for at, change in changes if at == tick)
        expected = sound | {link: ExternalWrench() for link in now if link not in sound}
        for nominal_fault, begins, ends in sorted(faults, key=lambda fault: fault[1]):
            if begins <= tick < ends:
                expected |= [set_by(nominal_fault.make_begin_change(campaign.scene))]
        assert now == expected, f"tick {tick}"
