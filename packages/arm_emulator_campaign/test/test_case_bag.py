"""Runs of campaigns as bags: `check-bag` drives each again, faults and all, to equal bits."""

from pathlib import Path

import pytest
from draws import some, with_slow
from test_campaign import MOVES, written
from test_campaign_lanes import VARIED, campaign_of

from arm_emulator.bags.comparison import compare_bag
from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.bags.run_bag import RunBag
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.new_bag import check_new_bag
from arm_emulator.ros.recording.bag import Bag
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.definition.scenario import count_ticks
from arm_emulator_campaign.simulation.case import draw_case
from arm_emulator_campaign.simulation.case_bag import write_case_bag
from arm_emulator_campaign.simulation.simulator import Simulator
from arm_emulator_msgs.msg import MachineEvent


def campaign(folder: Path, name: str) -> Campaign:
    return (
        load_campaign(written(folder, MOVES))
        if name == "moves"
        else campaign_of(folder, VARIED[name])
    )


ALONE = "a gear with play, without lanes"
NAMES = [*(name for name in VARIED if name != ALONE), "moves", ALONE]


@pytest.mark.parametrize("name", with_slow(NAMES, 3))
def test_a_run_is_repeated_from_its_bag_alone(tmp_path: Path, name: str) -> None:
    definition = campaign(tmp_path, name)
    simulator = Simulator(definition)
    for index in some(range(12), 2):
        case = draw_case(definition.variation, int(index))
        bag = tmp_path / f"bag_{index}"
        write_case_bag(definition, simulator, case, bag)
        comparison = compare_bag(bag)
        assert comparison.difference is None, comparison.difference
        seconds = min(case.seconds, simulator._scenario.seconds)
        assert comparison.tally.states == 1 + count_ticks(seconds, definition.scene.servo_period)
        assert comparison.tally.changes >= len(simulator._campaign.nominal[1]), (
            "the faults are in it"
        )
        simulator.simulate_run(case)  # as in the campaign: many ticks at a time
        *_, (_, last) = RecordedTopics(Bag(bag)).read_messages("emulator/joint_states")
        assert list(last.position) == simulator.session.state.q.tolist()
        assert list(last.effort) == simulator.session.state.gear_torque.tolist()


def test_a_fault_that_is_left_out_is_detected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    definition = campaign(tmp_path, "all that varies")
    plain, kinds = RunBag.write_change, []

    def all_but_the_push(bag: RunBag, kind: int) -> None:
        kinds.append(kind)
        if kind != MachineEvent.KIND_EXTERNAL_WRENCH:
            plain(bag, kind)

    monkeypatch.setattr(RunBag, "write_change", all_but_the_push)
    write_case_bag(
        definition, Simulator(definition), draw_case(definition.variation, 0), tmp_path / "bag"
    )
    assert kinds.count(MachineEvent.KIND_EXTERNAL_WRENCH) == 2
    comparison = compare_bag(tmp_path / "bag")
    assert comparison.difference is not None and "tick 51" in comparison.difference, (
        "from 0.05 s on"
    )


def test_a_bag_that_exists_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Refusal, match="must be new, got one that exists"):
        check_new_bag("campaign", tmp_path)
