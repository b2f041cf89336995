"""Faults of the machine in campaigns, by the names that every door uses."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from arm_emulator.base.refusal import Refusal
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.simulation.case import draw_case
from arm_emulator_campaign.simulation.simulator import Simulator

SENT = {
    "scene": "three_axis",
    "set": {"faults": ["elbow.command_late", "elbow.encoder_slips"]},
    "scenario": {"seconds": 0.2, "targets": [{"at": 0.0, "elbow": 1.0}]},
    "vary": {"faults.slip.magnitude": "uniform(-0.2, 0.2)"},
    "faults": {
        "slip": {"kind": "machine", "fault": "elbow.encoder_slips", "at": 0.1, "lasting": 0.05,
                 "magnitude": 0.1},
    },
    "measures": {"counts": "last(measured.encoder_counts.elbow)"},
    "count": 20,
}  # fmt: skip


def loaded(folder: Path, **fault: Any) -> Campaign:
    slip = {**SENT["faults"]["slip"], **fault}  # type: ignore[index]
    (folder / "c.yaml").write_text(yaml.safe_dump({**SENT, "faults": {"slip": slip}}))
    return load_campaign(folder / "c.yaml")


def test_a_fault_of_the_machine_begins_ends_and_varies(tmp_path: Path) -> None:
    """The counts jump by the drawn angle at its tick, and back at its end."""
    campaign = loaded(tmp_path)
    simulator = Simulator(campaign)
    session, j = simulator.session, 2
    per_rad = 1.0 / session.plant.link_angle_per_count[j] * session.scene.gear_ratios[j]
    for index in (3, 4):
        case = draw_case(campaign.variation, index)
        ticks = [session.tick for _ in simulator.drive_run(case)]
        assert ticks[-1] == round(0.2 / session.scene.servo_period)
        assert session.plant.parameters["faults.elbow.encoder_slips"] == 0.0
        magnitude = simulator.simulate_run(case).values["faults.slip.magnitude"]
        during = [
            (session.plant.parameters["faults.elbow.encoder_slips"],
             float(session.measured.encoder_counts[j] - session.state.theta_m[j] * per_rad))
            for _ in simulator.drive_run(case)
        ]  # fmt: skip
        on = [off for size, off in during if size == magnitude]
        assert on and {size for size, _ in during} == {0.0, magnitude}
        # The reading of the tick at which it begins is that of before.
        assert np.allclose(on[1:], magnitude * per_rad, rtol=0.0, atol=1.5)


def test_faults_that_the_scene_does_not_list_are_refused(tmp_path: Path) -> None:
    with pytest.raises(Refusal, match=r"fault must be listed by the scene, got elbow\.gear_breaks"):
        loaded(tmp_path, fault="elbow.gear_breaks")
    with pytest.raises(Refusal, match=r"magnitude must be"):
        loaded(tmp_path, fault="elbow.command_late", magnitude=17.0)
