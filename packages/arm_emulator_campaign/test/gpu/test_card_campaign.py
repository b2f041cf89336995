"""Campaigns on a card have the results of lanes, judged there or here: `make test-gpu`."""

import time
from pathlib import Path

import numpy as np
import pytest
from test_campaign_device import campaign_of
from test_campaign_lanes import VARIED, cases_of, rows_of
from test_device_program import load

from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.simulation.batch_simulator import make_simulator
from arm_emulator_campaign.simulation.outcome import Outcomes

pytest_plugins = ["cards"]
pytestmark = pytest.mark.usefixtures("card")

COUNT = 300
# These campaigns have one machine, so that its kernels are compiled once.
NAMES = "all that varies", "faults over each other", "a table of targets"


def compare(campaign: Campaign) -> None:
    found = {}
    for device in (None, "gpu"):
        simulator = make_simulator(campaign, device)
        found[device] = rows_of(
            Outcomes.join_outcomes(list(simulator.simulate_runs(cases_of(campaign, range(COUNT)))))
        )
    assert np.array_equal(found["gpu"], found[None], equal_nan=True)


@pytest.mark.parametrize("name", NAMES)
def test_runs_judged_on_a_card_equal_those_in_lanes(tmp_path: Path, name: str) -> None:
    compare(load(tmp_path, name))


@pytest.mark.parametrize("name", NAMES[:1])
def test_runs_of_a_card_judged_here_equal_those_in_lanes(tmp_path: Path, name: str) -> None:
    compare(campaign_of(tmp_path, VARIED[name]))


def test_a_campaign_takes_so_long_for_a_run(tmp_path: Path) -> None:
    campaign = load(tmp_path, "all that varies")
    simulator, cases = make_simulator(campaign, "gpu"), cases_of(campaign, range(4000))
    for count in (COUNT, len(cases)):
        began = time.perf_counter()
        assert sum(len(part.indices) for part in simulator.simulate_runs(cases[:count])) == count
        seconds = time.perf_counter() - began
        print(f"{count} runs: {1e6 * seconds / count:.1f} us a run")
