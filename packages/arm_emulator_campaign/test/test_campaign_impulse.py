"""A blow against the tool in campaigns, beside the change of speed that follows from inertia."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from draws import with_slow

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.session.tool_chain import ToolChain
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.simulation.case import Case, draw_case
from arm_emulator_campaign.simulation.simulator import Simulator

HIT = {"kind": "impulse", "at": 0.005, "link": "tool", "impulse": [0.1, -0.2, 0.3]}


def loaded(folder: Path, **hit: object) -> Campaign:
    data = {
        "scene": "three_axis",
        "set": {"joints.*.gear.stiffness": 50.0, "joints.*.gear.damping": 0.01},
        "scenario": {"seconds": 0.02, "start": {"shoulder": 0.4, "elbow": 0.8}},
        "faults": {"hit": {**HIT, **hit}},
        "count": 1,
    }
    (folder / "c.yaml").write_text(yaml.safe_dump(data))
    return load_campaign(folder / "c.yaml")


def changed_speed(campaign: Campaign) -> tuple[np.ndarray, Simulator]:
    """Return by how much the blow has changed the speeds of the links when contact ends."""
    simulator = Simulator(campaign)
    session, case = simulator.session, draw_case(campaign.variation, 0)
    states = [(session.tick, session.state.v.copy()) for _ in simulator.drive_run(case)]
    ends, v = states[2]  # after start and begin of the contact
    sound = Simulator(campaign)
    for _ in sound.drive_run(Case(0, {}, 0.0, frozenset({"hit"}), ends * 1e-3)):
        pass
    assert sound.session.tick == ends
    return v - sound.session.state.v, sound


@pytest.mark.parametrize("contact", with_slow([1, 3], 1))
def test_speeds_change_by_the_impulse_over_inertia(tmp_path: Path, contact: int) -> None:
    changed, simulator = changed_speed(loaded(tmp_path, lasting=contact * 1e-3))
    scene, q = simulator.session.scene, simulator.session.state.q
    steps = q[:, None] + np.hstack([1e-6 * np.eye(3), -1e-6 * np.eye(3)])
    p = ToolChain(scene).compute_positions(steps)
    J = (p[:, :3] - p[:, 3:]) / 2e-6
    M = simulator.session.plant.links.mass_matrix(q)
    expected = np.linalg.solve(M, J.T @ HIT["impulse"])
    # Friction and yielding gears take back below 1 % in a millisecond.
    assert np.abs(changed - expected).max() < 0.01 * contact * np.abs(expected).max()
    assert np.abs(expected).max() > 0.1


def test_a_link_that_stands_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Refusal, match="must be one that moves"):
        loaded(tmp_path, link="world")
    with pytest.raises(Refusal, match="impulse"):
        loaded(tmp_path, impulse=[1.0, 2.0])
