"""Requirements on the vibration after a stop, against the same run by hand."""

import numpy as np
import pytest
import yaml

from arm_emulator.analysis.residual_vibration import measure_vibration
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.runs.offline import load_offline_run
from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.simulation.simulator import Simulator

PERIOD, MOTION = 1e-3, 50  # s, and ticks of a motion period
MOVED = {
    "scene": "three_axis",
    "scenario": {"seconds": 1.0, "table": "targets.csv"},
    "requirements": {},
    "count": 1,
}


def write(folder, requirements):
    names = load_scene("three_axis").joint_names
    q = load_scene("three_axis").start
    rows = [[0.05 * k, *(q + [0.03 * min(k, 6), 0.0, 0.0])] for k in range(12)]  # noqa: RUF005
    text = "\n".join(",".join(map(str, row)) for row in [["t", *names], *rows])
    (folder / "targets.csv").write_text(text + "\n")
    file = folder / "c.yaml"
    file.write_text(yaml.safe_dump(MOVED | {"requirements": requirements}))
    return file


def test_the_margin_is_that_of_the_run_by_hand(tmp_path):
    """Targets move six times, 50 ms apart: the reference ends 50 ms after the last of them."""
    requirements = {
        f"{source}-{quantity}": {
            "vibration": quantity, "from": source, "at_most": limit, "band": 2e-4,
        }
        for source in ("truth", "encoders")
        for quantity, limit in (("largest", 0.01), ("swing", 0.01), ("rms", 0.02), ("settled", 0.5))
    }  # fmt: skip
    trace = {"python": "checks.py:keep", "signals": ["q.*", "measured.encoder_counts.*"]}
    (tmp_path / "checks.py").write_text(
        "import numpy\ndef keep(t):\n"
        f"    numpy.savez({str(tmp_path / 'trace.npz')!r}, **t)\n    return 1.0\n"
    )
    file = write(tmp_path, {**requirements, "keep": trace})
    robustness = Simulator(load_campaign(file)).simulate_run(0).robustness
    rows, scene = np.load(tmp_path / "trace.npz"), load_scene("three_axis")
    tool = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    end = 7 * MOTION
    for source, names in (("truth", "q.{}"), ("encoders", "measured.encoder_counts.{}")):
        q = np.array([rows[names.format(joint)] for joint in scene.joint_names]).T
        if source == "encoders":
            q = q * [2.0 * np.pi * j.gear.ratio / j.counts_per_turn for j in scene.joints]
        places = np.array([tool.forward(row)[1] for row in q[end:]])
        vibration = measure_vibration(places, PERIOD, 2e-4)
        for quantity, limit in (("largest", 0.01), ("rms", 0.02), ("settled", 0.5)):
            margin = robustness[f"{source}-{quantity}"]
            assert margin == pytest.approx(limit - getattr(vibration, quantity), abs=1e-9)
    assert robustness["truth-largest"] < 0.0099, "the arm still moves when its reference has ended"


def test_a_run_that_ends_with_its_reference_fails(tmp_path):
    file = write(tmp_path, {"still": {"vibration": "swing", "at_most": 1.0}})
    file.write_text(file.read_text().replace("seconds: 1.0", "seconds: 0.3"))
    assert Simulator(load_campaign(file)).simulate_run(0).robustness["still"] == -np.inf


@pytest.mark.parametrize(
    ("requirement", "words"),
    [
        ({"vibration": "shake", "at_most": 1e-3}, "still.vibration must be one of the known"),
        ({"vibration": "swing"}, "still.at_most must be"),
        ({"vibration": "swing", "at_most": -1.0}, "still.at_most must be a number from 0"),
        ({"vibration": "swing", "at_most": 1.0, "band": 0.0}, "still.band must be a number > 0"),
        ({"vibration": "swing", "at_most": 1.0, "from": "page"}, "still.from must be one of"),
        ({"vibration": "swing", "at_most": 1.0, "within": 1}, "still.within must be known"),
    ],
)
def test_a_requirement_that_makes_no_sense_is_refused(tmp_path, requirement, words):
    with pytest.raises(Refusal, match=words):
        Simulator(load_campaign(write(tmp_path, {"still": requirement})))


def test_moves_of_the_motion_controller_are_judged_too(tmp_path):
    run = load_offline_run("three_axis")
    assert run.motion_ticks == MOTION
    data = MOVED | {
        "scenario": {"seconds": 4.0, "moves": [{"at": 0.0, "by": [0, 0.03, 0]}]},
        "requirements": {"still": {"vibration": "swing", "at_most": 1e-3}},
    }
    file = tmp_path / "c.yaml"
    file.write_text(yaml.safe_dump(data))
    assert 0.9e-3 < Simulator(load_campaign(file)).simulate_run(0).robustness["still"] <= 1e-3
