"""Links keep their limits of acceleration on the whole way, whatever the motion period is."""

import dataclasses

import numpy as np
import pytest
from draws import some, with_slow

from arm_emulator import Kinematics, Scene, load_gains, load_scene
from arm_emulator.design.new_scene import write_new
from arm_emulator.runs.gains import Gains
from oracles.any_arm import draw_reachable, move_arm
from oracles.own_robots import OWN

ARMS = "scara", "spherical_wrist", "tilted"


@pytest.fixture(scope="module")
def sized_arms(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Scene, Gains]]:
    """Arms from descriptions, whose drives are sized for their accelerations."""
    result = {}
    for name in some(ARMS, 1):
        folder = tmp_path_factory.mktemp(name)
        (folder / f"{name}.urdf").write_text(OWN[name](), encoding="utf-8")
        file = write_new(folder / f"{name}.urdf", folder / "new").file
        result[name] = load_scene(file), load_gains(file)
    return result


@pytest.mark.slow
@pytest.mark.parametrize("period", with_slow(some([0.01, 0.05, 0.005, 0.02, 0.1], 2), 1))
@pytest.mark.parametrize("arm", some(ARMS, 1))
def test_links_keep_their_accelerations(
    sized_arms: dict[str, tuple[Scene, Gains]], arm: str, period: float
) -> None:
    """The servo knows a changed acceleration a period late, and links swing on their gears."""
    scene, gains = sized_arms[arm]
    motion = dataclasses.replace(gains.motion, period=period, collisions="off")
    servo = dataclasses.replace(gains.servo, motion_period=period)
    kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    rng = np.random.default_rng(round(period * 1e4))
    for _ in range(3):
        pair = draw_reachable(kinematics, 0.3 * min(1.0, kinematics.reach / 0.8), rng)
        assert pair is not None
        outcome = move_arm(scene, dataclasses.replace(gains, servo=servo, motion=motion), "", *pair)
        assert not outcome.words
        assert outcome.peak_acceleration < 1.0
        assert outcome.peak_speed < 1.0
