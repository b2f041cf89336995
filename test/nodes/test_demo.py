"""The demo: three processes make the paper's experiment, and report the truth about it."""

import dataclasses
import json
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from draws import some

from arm_emulator.base.io.config_files import find_scene
from arm_emulator.demo.demo_plan import DemoPlan
from arm_emulator.demo.predicted_rest import NEAR, predict_rest
from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator.machine.scene.urdf_file import find_example_robot_data
from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator.runs.gains import Gains, load_gains
from arm_emulator.runs.offline import load_offline_run

needs_robots = pytest.mark.skipif(
    find_example_robot_data() is None, reason="needs the package example-robot-data (make robots)"
)


def load_demo(scene_name: str) -> tuple[Scene, Gains, DemoPlan]:
    file = find_scene(scene_name)
    gains = load_gains(file)
    return load_scene(file), gains, DemoPlan.load_plan(file, round(gains.motion.period * 1e9))


def signal_of(recording: Path, entity: str) -> dict[int, float]:
    """Return the numbers of an entity in a Rerun recording by their times [ns]."""
    from rerun.chunk import RrdReader

    values: dict[int, float] = {}
    for chunk in RrdReader(recording).stream().filter(content=entity, is_static=False):
        batch = chunk.to_record_batch()
        times = batch.column("t").cast("int64").to_pylist()
        rows = batch.column("Scalars:scalars").to_pylist()
        values.update((time, row[0]) for time, row in zip(times, rows, strict=True))
    return values


@pytest.mark.slow
@pytest.mark.parametrize("scene", some(["three_axis", pytest.param("ur5", marks=needs_robots)], 1))
def test_demo(scene: str, tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "arm_emulator",
        "demo",
        scene,
        "--out",
        str(tmp_path),
        "--json",
    ]
    with own_domain():
        done = subprocess.run(command, capture_output=True, text=True, timeout=600.0, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    summary = json.loads((tmp_path / "demo.json").read_text())
    assert json.loads(done.stdout) == {**summary, "warnings": []}
    deviations = np.array(summary["deviations_m"])

    # Three processes state to the last bit what one process states.
    predicted = predict_rest(*load_demo(scene))
    assert np.array_equal(deviations, predicted.deviations)
    assert summary["predicted_mm"] == summary["residual_mm"] and summary["target"] == "reached"

    assert summary["scene"] == scene and summary["clock"] == "lockstep"
    start = np.linalg.norm(deviations[0]) * 1e3
    assert summary["start_mm"] == pytest.approx(start)
    assert summary["residual_mm"] == pytest.approx(list(deviations[-1] * 1e3))
    distance = np.linalg.norm(deviations, axis=1)
    below = np.flatnonzero(distance < 0.01 * distance[0])  # never, where gravity winds gears up
    assert summary["instructions_to_1_percent"] == (int(below[0]) if len(below) else None)
    printed = done.stderr
    assert "the target is reached, and the residual is the predicted one" in printed
    assert printed.index("predicted residual (mm)") < printed.index("instruction "), (
        "before the run"
    )
    if scene == "three_axis":  # as the paper's arm does
        assert below[0] <= 20
        assert f"after {below[0]} instructions" in printed

    from matplotlib.image import imread

    picture = imread(tmp_path / "fig4.png")
    assert min(picture.shape[:2]) > 200 and picture[..., :3].std() > 0.01  # not a blank page
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # of a file without its end
        run = load_offline_run(scene)
        machine, forward = run.session.scene, run.controller.kinematics.forward
        signals = [
            signal_of(tmp_path / "demo.rrd", f"/signals/q/{joint}") for joint in machine.joint_names
        ]
    assert min(signals[0]) == 0
    # At its end the recording has the motion that follows the experiment, so that it can be seen.
    plan = DemoPlan.load_plan(find_scene(scene), run.session.period_ns * run.motion_ticks)
    assert plan.motion is not None and np.linalg.norm(plan.motion) > 0.2  # m
    end = forward(np.array([values[max(values)] for values in signals]))[1]
    # 1 mm: the residual of encoders and of gears under the weight is below (docs/validation).
    assert np.linalg.norm(end - forward(machine.start)[1] - plan.motion) < 1e-3


def test_the_prediction_names_the_missed_target_or_place() -> None:
    """A place beside the predicted one, a target out of reach, one that is not reached yet."""
    scene, gains, plan = load_demo("three_axis")
    met = predict_rest(scene, gains, plan)
    assert met.target == "reached" and met.describe_miss(met.deviations, exact=True) == ""
    beside = met.deviations + 0.5 * NEAR * np.linalg.norm(met.deviations[0]) * np.eye(3)[0]
    assert met.describe_miss(beside, exact=False) == ""
    assert "beside the predicted place" in met.describe_miss(beside, exact=True)
    assert "beside the predicted place" in met.describe_miss(met.deviations + 1e-3, exact=False)
    path_gains = dataclasses.replace(gains, motion=dataclasses.replace(gains.motion, method="way"))
    far = dataclasses.replace(plan, displacement=np.array([5.0, 0.0, 0.0]), instructions=400)
    for target, variant in (
        ("out of reach", far),
        ("not yet there", dataclasses.replace(plan, instructions=3)),
    ):
        result = predict_rest(scene, path_gains, variant)
        assert result.target == target
        assert f"the target is {target}" in result.describe_miss(result.deviations, exact=True)
