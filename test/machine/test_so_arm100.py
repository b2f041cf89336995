"""The SO-ARM100: an arm of published joints."""

import numpy as np
import pinocchio as pin
import pytest
import yaml

from arm_emulator import Plant, load_scene
from arm_emulator.base.io.config_files import find_config_folder
from arm_emulator.cli.commands.run import run_scene
from arm_emulator.view.rerun_batches import LinkPositions

CONFIG = find_config_folder()


def test_its_servos_are_those_of_the_data_file() -> None:
    data = yaml.safe_load((CONFIG / "joints" / "sts3215.yaml").read_text())
    scene = yaml.safe_load((CONFIG / "so_arm100.yaml").read_text())
    servo = data["joints"]["sts3215"]
    assert scene["supply_voltage"] == data["supply_voltage"]
    for name, joint in scene["joints"].items():
        assert {key: joint[key] for key in servo} == servo, name


@pytest.mark.slow
def test_its_motors_hold_it_within_their_dry_friction(capsys: pytest.CaptureFixture[str]) -> None:
    """At rest under its servo a motor's torque is the weight's, by Pinocchio, up to friction."""
    scene = load_scene("so_arm100")
    assert scene.warnings == []
    assert run_scene("so_arm100", seconds=3.0) == 0, capsys.readouterr()
    model = pin.buildModelFromUrdf(str(CONFIG / "urdf" / "so_arm100.urdf"))
    q = np.append(scene.start, 0.0)  # the jaw is the last joint
    weight = pin.computeGeneralizedGravity(model, model.createData(), q)[:-1]
    plant = Plant(scene)
    ratio, Kt, R = 1.0 / 345.0, 0.003512, 2.67617
    friction = 1.51864e-4
    for share, holds in ((0.99, True), (1.01, False)):
        moved = []
        for direction in (-1.0, 1.0):
            plant.reset()
            plant.put("test", {"theta_m": (scene.start + weight / 200.0) / ratio})
            volts = R / Kt * (ratio * weight + direction * share * friction)
            plant.advance(volts, 1000)
            moved.append(np.abs(plant.state.theta_m * ratio - weight / 200.0 - scene.start))
        assert (np.min(moved, axis=0) > 1e-9).all() != holds
        assert (np.max(moved, axis=0) < 1e-9).all() == holds


@pytest.mark.slow
def test_its_test_motion_ends_within_a_count_of_its_encoders() -> None:
    assert run_scene("so_arm100", displacement=(-0.0032, 0.0078, 0.0248), seconds=4.0) == 0


def test_a_link_appears_at_its_place_though_a_joint_has_its_name() -> None:
    """The jaw is both, in many descriptions."""
    scene = load_scene("so_arm100")
    text = (CONFIG / "urdf" / "so_arm100.urdf").read_text()
    model = pin.buildModelFromXML(text)
    data = model.createData()
    pin.forwardKinematics(model, data, np.append(scene.start, 0.0))
    expected = data.oMi[model.getJointId("jaw")].translation
    positions = LinkPositions(text, scene.joint_names)("jaw", scene.start[None])
    assert positions[0] == pytest.approx(expected, abs=1e-12)
