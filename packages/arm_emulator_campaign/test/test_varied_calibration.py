"""Campaigns that draw an arm's true kinematics: tools are where its joints stand in each run."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from draws import with_slow
from test_calibration import displaced_urdf, tool_by_pinocchio

from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.simulation.batch_simulator import BatchSimulator
from arm_emulator_campaign.simulation.case import draw_cases
from arm_emulator_campaign.simulation.simulator import Simulator

JOINTS = "waist", "shoulder", "elbow"


def write_campaign(folder: Path) -> Path:
    measures = {f"q_{joint}": f"last(q.{joint})" for joint in JOINTS}
    measures |= {axis: f"last(tool.{axis})" for axis in "xyz"}
    data: dict[str, Any] = {
        "scene": "three_axis",
        "set": {"calibration": {}},
        "vary": {
            "calibration.joints.*.x": "normal(0, 2e-3)",
            "calibration.joints.elbow.roll": "normal(0, 2e-2)",
            "calibration.joints.shoulder.yaw": "uniform(-0.02, 0.02)",
        },
        "scenario": {"seconds": 0.05, "targets": [{"at": 0.01, "waist": 0.2}]},
        "measures": measures,
        "count": 6,
    }
    (folder / "c.yaml").write_text(yaml.safe_dump(data))
    return folder / "c.yaml"


@pytest.mark.parametrize("kind", with_slow([Simulator, BatchSimulator], 1))
def test_tools_stand_by_the_pictured_places(tmp_path: Path, kind: Any) -> None:
    campaign = load_campaign(write_campaign(tmp_path))
    simulator, scene = kind(campaign), campaign.scene
    names = list(campaign.measures)
    cases = draw_cases(campaign.variation, range(6))
    apart = []
    for outcomes in simulator.simulate_runs(cases):
        for index, row in zip(outcomes.indices, outcomes.measures, strict=True):
            measured = dict(zip(names, row, strict=True))
            deltas: dict[str, dict[str, float]] = {}
            for name, value in cases[index].values.items():
                _, _, joint, key = name.split(".")
                deltas.setdefault(joint, {})[key] = value
            q = np.array([measured[f"q_{joint}"] for joint in scene.joint_names])
            place = tool_by_pinocchio(displaced_urdf(scene.urdf, deltas), scene, q)[:3, 3]
            assert [measured[axis] for axis in "xyz"] == pytest.approx(place, abs=1e-12)
            apart.append(np.abs(place - tool_by_pinocchio(scene.urdf, scene, q)[:3, 3]).max())
    assert len(apart) == 6 and min(apart) > 1e-4, "each arm is another"
