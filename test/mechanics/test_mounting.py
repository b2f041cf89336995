"""Arms on a wall, under a ceiling, on a slope: gravity in the scene, or a base that is turned."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from draws import some
from scipy.spatial.transform import Rotation
from test_new_drives import untuned

from arm_emulator import Kinematics, Plant, load_gains, load_scene
from arm_emulator.analysis.holding import find_overloads
from arm_emulator.design.new_scene import write_new
from oracles.any_arm import draw_reachable, move_arm
from oracles.own_robots import RobotPart, write_serial

__all__ = ["untuned"]  # a fixture

DOWN = np.array([0.0, 0.0, -9.81])
MOUNTS = {"slope": (0.4, -0.3, 0.8), "wall": (0.0, np.pi / 2, 0.0), "ceiling": (np.pi, 0.0, 0.0)}
PARTS = [
    RobotPart("0 0 1", (0.0, 0.0, 0.2), 2.0, effort=40.0, velocity=3.0),
    RobotPart("0 1 0", (0.3, 0.0, 0.0), 1.5, effort=40.0, velocity=3.0),
    RobotPart("0 1 0", (0.2, 0.05, 0.0), 0.8, effort=15.0, velocity=3.0),
]


@pytest.mark.slow
@pytest.mark.parametrize("mount", some(MOUNTS, 1))
def test_gravity_in_the_scene_is_a_base_that_is_turned(mount: str, tmp_path: Path) -> None:
    """The same machine in the axes of its base: equal motions, and it arrives where it is sent."""
    R_WB = Rotation.from_euler("xyz", MOUNTS[mount]).as_matrix()
    gravity = (R_WB.T @ DOWN).tolist()
    file = tmp_path / "arm.urdf"
    file.write_text(write_serial("arm", PARTS))
    written = write_new(file, tmp_path / "new")
    upright = load_scene(written.file, {"gravity": gravity})
    text = written.file.read_text()
    rpy = " ".join(map(repr, MOUNTS[mount]))
    (tmp_path / "turned.urdf").write_text(write_serial("arm", PARTS, base_rpy=rpy))
    turned_file = tmp_path / "turned.yaml"
    turned_file.write_text(text.replace("urdf/arm.urdf", "turned.urdf"))
    turned = load_scene(turned_file)
    slanted, turned_base = Plant(upright), Plant(turned)
    draw = np.random.default_rng(0)
    for _ in range(50):
        u = draw.normal(size=3) * [0.5, 0.5, 0.2]
        slanted.advance(u, 20)
        turned_base.advance(u, 20)
    assert np.abs(slanted.state.q - upright.start).max() > 0.02, "it moves"
    np.testing.assert_allclose(slanted.state.q, turned_base.state.q, rtol=0.0, atol=1e-10)
    gains = load_gains(written.file)
    motion = dataclasses.replace(
        gains.motion, gravity_x=gravity[0], gravity_y=gravity[1], gravity_z=gravity[2]
    )
    gains = dataclasses.replace(gains, motion=motion)
    kinematics = Kinematics(upright.urdf, upright.joint_names, upright.tool)
    pair = draw_reachable(kinematics, 0.1, np.random.default_rng(3))
    assert pair is not None
    done = move_arm(upright, gains, "100 mm", *pair)
    assert not done.words and done.peak_speed <= 1.0 and done.seconds < 6.0, done
    assert not done.has_overshot, done


@pytest.mark.usefixtures("untuned")
def test_a_mount_that_the_motors_do_not_hold_is_reported(tmp_path: Path) -> None:
    """The first joint carries weight as soon as the base is turned."""
    file = tmp_path / "arm.urdf"
    weak = [dataclasses.replace(PARTS[0], effort=4.0), *PARTS[1:]]
    file.write_text(write_serial("arm", weak))
    written = write_new(file, tmp_path / "new")
    assert not written.overloads, "upright, the first joint carries no weight"
    on_wall = find_overloads(load_scene(written.file, {"gravity": [9.81, 0.0, 0.0]}))
    assert [load.joint for load in on_wall] == ["j1"]
    # j1 turns about z, and on a wall the arm stretched out pulls at its own length.
    stretched = 9.81 * (1.5 * 0.15 + 0.8 * 0.4)
    assert 0.8 < on_wall[0].takes / stretched <= 1.05


def test_the_holding_torque_is_weight_plus_all_torques_of_the_angle() -> None:
    """A table of torques counts as the spring does that it was measured at."""
    push = {"angles": [-7.0, -2.0, 2.0, 7.0], "torques": [-1e4] * 4}
    free, pushed = (load_scene("ur5", {"joints.elbow_joint.torque_table": table})
                    for table in (None, push))  # fmt: skip
    assert "elbow_joint" not in {overload.joint for overload in find_overloads(free)}
    (load,) = (overload for overload in find_overloads(pushed) if overload.joint == "elbow_joint")
    assert load.takes == pytest.approx(1e4, rel=1e-2)
