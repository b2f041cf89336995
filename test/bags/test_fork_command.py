"""`run --bag` and `fork`: another future from any moment of a bag, to the last bit."""

import json
import math
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from draws import with_slow
from machines import own_three_axis

from arm_emulator import Refusal, Session, load_scene
from arm_emulator.bags.comparison import compare_bag
from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.bags.timeline_bag import ORDERS
from arm_emulator.cli.commands.fork import fork_run
from arm_emulator.cli.commands.run import run_scene
from arm_emulator.machine.plant.plant_state import SET
from arm_emulator.ros.recording.bag import Bag
from arm_emulator.ros.recording.bag_metadata import FORKED_AT, PARENT
from arm_emulator.runs.offline import load_offline_run
from arm_emulator.runs.order import (
    MoveTool,
    Order,
    Push,
    ScaleGains,
    SetVaried,
    SwitchPower,
    convert_to_data,
    read_order,
)
from arm_emulator_msgs.msg import MachineEvent

VISCOUS = "joints.elbow.friction.viscous"
BREAKS = "faults.elbow.gear_breaks"
LAST = 300  # ticks of 1 ms
# Requests: words of the command, the order, and the kind of its event; 0: none.
REQUESTS: dict[str, tuple[dict[str, Any], Order, int]] = {
    "move": ({"displacement": (0.0, -0.04, 0.01)}, MoveTool((0.0, -0.04, 0.01)), 0),
    "power": ({"power": "off"}, SwitchPower(on=False), MachineEvent.KIND_POWER),
    "gains": ({"gains": 2.0}, ScaleGains(2.0), 0),
    "friction": (
        {"set_": [f"{VISCOUS}=0.5"]}, SetVaried(VISCOUS, 0.5), MachineEvent.KIND_SET_VARIED,
    ),
    "fault": ({"set_": [f"{BREAKS}=1"]}, SetVaried(BREAKS, 1.0), MachineEvent.KIND_SET_VARIED),
    "push": (
        {"push": ("forearm", 0.0, 3.0, 0.0)}, Push("forearm", (0.0, 3.0, 0.0)),
        MachineEvent.KIND_EXTERNAL_WRENCH,
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    more = f"external_wrench: true\nvaried: [{VISCOUS}]\nfaults: [elbow.gear_breaks]"
    return own_three_axis(tmp_path_factory.mktemp("scene") / "own", more)


@pytest.fixture(scope="module")
def straight(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    bag = tmp_path_factory.mktemp("bags") / "straight"
    code = run_scene(str(scene), seconds=LAST * 1e-3, displacement=(0.0, 0.05, 0.0), bag=bag)
    assert code == 1, "the tool is still on its way"
    return bag


def truth(session: Session) -> list[bytes]:
    """The state of a machine; a saved one also holds the command of the period to come."""
    return [getattr(session.state, name).tobytes() for name in (*SET, "gear_torque")]


def recorded(bag: Path, scene: Path) -> RecordedMachine:
    machine = RecordedMachine.open_run(bag, load_scene(scene))
    machine.advance(machine.last)
    return machine


@pytest.mark.parametrize("requested", with_slow(REQUESTS, 1))
def test_a_fork_is_the_run_that_would_have_been_changed_there(
    requested: str, scene: Path, straight: Path, tmp_path: Path
) -> None:
    words, order, kind = REQUESTS[requested]
    at = random.Random(requested).randrange(20, 250)
    bag = tmp_path / "fork"
    assert fork_run(straight, bag, at=at * 1e-3, seconds=0.06, scene=str(scene), **words) == int(
        "displacement" in words  # the tool is still on its way
    )
    result = compare_bag(bag, str(scene))
    assert result.difference is None and result.tally.states == at + 61
    about = Bag(bag).about
    assert about[PARENT] == str(straight) and about[FORKED_AT] == str(at)
    straight_run = load_offline_run(str(scene))
    MoveTool((0.0, 0.05, 0.0))(straight_run)
    straight_run.advance(at)
    order(straight_run)
    straight_run.advance(60)
    machine = recorded(bag, scene)
    assert truth(machine.session) == truth(straight_run.session), "to the last bit"
    assert {
        tick: [int(straight_run.kind) for straight_run in compiled]
        for tick, compiled in machine.changes.items()
    } == ({at: [kind]} if kind else {})


@pytest.mark.slow
def test_forks_of_forks_have_all_orders_of_their_past(
    scene: Path, straight: Path, tmp_path: Path
) -> None:
    first, second, third = (tmp_path / name for name in ("first", "second", "third"))
    assert fork_run(straight, first, at=0.2, gains=1.5, power="off", scene=str(scene)) == 0
    assert fork_run(first, second, at=0.25, power="on", seconds=0.1, scene=str(scene)) == 0
    assert fork_run(second, third, at=0.35, seconds=0.0, scene=str(scene)) == 0
    assert [straight_run["tick"] for straight_run in json.loads(Bag(third).about[ORDERS])] == [
        0,
        200,
        200,
        250,
    ]
    straight_run = load_offline_run(str(scene))
    MoveTool((0.0, 0.05, 0.0))(straight_run)
    straight_run.advance(200)
    SwitchPower(on=False)(straight_run)
    ScaleGains(1.5)(straight_run)
    straight_run.advance(50)
    SwitchPower(on=True)(straight_run)
    straight_run.advance(100)
    for bag in (second, third):
        assert truth(recorded(bag, scene).session) == truth(straight_run.session)


def spoiled(change: Callable[[Any], Any]) -> Callable[[Path], None]:
    def spoil(bag: Path) -> None:
        file = bag / "metadata.yaml"
        body = yaml.safe_load(file.read_text())
        facts = body["rosbag2_bagfile_information"]["custom_data"]
        facts[ORDERS] = change(json.loads(facts[ORDERS]))
        file.write_text(yaml.safe_dump(body))

    return spoil


@pytest.mark.parametrize(("spoil", "rule"), [
    (spoiled(lambda _: "no JSON"), "orders must be JSON"),
    (spoiled(lambda _: "7"), "tick of an order must be a number from 0 on"),
    (spoiled(lambda log: json.dumps([{**log[0], "tick": -1}])), "tick of an order"),
    (spoiled(lambda log: json.dumps([{**log[0], "kind": "x"}])), "be of a known kind"),
    (spoiled(lambda log: json.dumps([{**log[0], "by": [0, 1]}])), "order, by must be a Vector"),
    (spoiled(lambda log: json.dumps([{**log[0], "by": [0, 0.03, 0]}])), "lead to the recorded"),
    (spoiled(lambda _: "[]"), "lead to the recorded"),
], ids=range(7))  # fmt: skip
def test_orders_that_are_not_of_the_bag_are_refused(
    spoil: Callable[[Path], None], rule: str, scene: Path, straight: Path, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    shutil.copytree(straight, bag)
    spoil(bag)
    with pytest.raises(Refusal, match=rule):
        fork_run(bag, tmp_path / "new", at=0.1, scene=str(scene))
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(("words", "rule"), [
    ({"at": 0.4}, "--at must be within 0 and 0.3 s"), ({"at": math.nan}, "--at must be"),
    ({"at": 0.1, "seconds": -1.0}, "--seconds must be"), ({"at": 0.1, "gains": 0.0}, "above 0"),
    ({"at": 0.1, "set_": ["payload.mass=1"]}, "be varied in the scene"),
    ({"at": 0.1, "set_": ["payload.mass"]}, "--set must be NAME=VALUE"),
    ({"at": 0.1, "push": ("nowhere", 1.0, 0.0, 0.0)}, "link"),
])  # fmt: skip
def test_impossible_requests_are_refused_and_write_nothing(
    words: dict[str, Any], rule: str, scene: Path, straight: Path, tmp_path: Path
) -> None:
    with pytest.raises(Refusal, match=rule):
        fork_run(straight, tmp_path / "new", scene=str(scene), **words)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("requested", REQUESTS)
def test_orders_are_the_same_after_a_file(requested: str) -> None:
    order = REQUESTS[requested][1]
    assert read_order("file", json.loads(json.dumps(convert_to_data(order)))) == order
