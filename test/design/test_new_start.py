"""A new scene starts where no parts of its arm touch, if there is such a pose."""

import re
from pathlib import Path

import numpy as np
import pytest
from draws import some, with_slow

from arm_emulator.base.io.config_files import find_beside
from arm_emulator.design import new_scene
from arm_emulator.design.new_scene import write_new
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.motion.collision.collisions import Collisions
from arm_emulator.motion.model.config import MotionConfig, load_motion_config
from oracles.own_robots import RobotPart, write_serial


@pytest.fixture(autouse=True)
def untuned(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gains are not computed, for which the machine is compiled: the test is of the start."""
    monkeypatch.setattr(new_scene, "tune_servo", lambda _, servo: servo)


def with_balls(rng: np.random.Generator) -> str:
    """An arm whose links end in balls, so large that they touch in many poses."""
    joints = int(rng.integers(5, 8))
    axes = ["0 0 1", *rng.choice(["0 1 0", "1 0 0"], joints - 1)]
    rods = rng.uniform(0.15, 0.3, joints)
    parts = [
        RobotPart(axis, (float(rod), 0.0, 0.05), 1.0) for axis, rod in zip(axes, rods, strict=True)
    ]
    text = write_serial("balls", parts)
    for k, rod in enumerate(rods, start=1):
        ball = (
            f'<collision><origin xyz="{rod} 0 0.05"/>'
            f'<geometry><sphere radius="{rng.uniform(0.1, 0.14)}"/></geometry></collision>'
        )
        text, count = re.subn(rf'(<link name="l{k}"[^>]*>)', rf"\1{ball}", text, count=1)
        assert count == 1
    return text


@pytest.mark.parametrize("seed", with_slow(some([12, 18, 43, *range(60)], 8), 3))
def test_no_parts_touch_at_the_start_where_a_pose_without_contact_exists(
    seed: int, tmp_path: Path
) -> None:
    """Of 60 such arms 4 touched themselves at the start, and were not watched therefore."""
    rng = np.random.default_rng(seed)
    robot = tmp_path / "balls.urdf"
    robot.write_text(with_balls(rng), encoding="utf-8")
    file = write_new(robot, tmp_path / "new").file
    scene, motion = load_scene(file), load_motion_config(find_beside(file, "motion"))
    tested = Collisions(scene.urdf, scene.joint_names, (), MotionConfig().collision_margin)
    assert not tested.find_first_contact(scene.start)
    touching = [
        bool(tested.find_first_contact(tested.sample_configuration(rng))) for _ in range(100)
    ]
    collisions = "stop" if tested.pairs else "auto"
    assert motion.collisions == collisions or np.mean(touching) > 0.7, "touching nearly everywhere"
