"""Kinematics and torques of many configurations at once, against Pinocchio one by one."""

import re
from collections.abc import Callable

import numpy as np
import pytest
from draws import some
from machines import write_random_chain

from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.motion.model.arm_tree import ArmTree
from arm_emulator.motion.model.kinematics import Kinematics, list_moving_joints
from arm_emulator.motion.model.link_torques import LinkTorques
from oracles.own_robots import OWN

GRAVITY = (1.0, -2.0, -9.0)


def sliding() -> str:
    """Return a chain of random joints, some of which slide on links that turn."""
    urdf = write_random_chain(np.random.default_rng(2), 6)
    kinds = re.findall(r'<joint name="\w+" type="(\w+)"', urdf)
    assert kinds.count("prismatic") == 3 and "revolute" in kinds[:2], kinds
    return urdf


# The last arm has joints that slide on links that turn.
ARMS = [*((name, OWN[name]) for name in some(sorted(OWN), 6)), ("slides", sliding)]


@pytest.mark.parametrize("make", [make for _, make in ARMS], ids=[name for name, _ in ARMS])
def test_it_is_pinocchio_in_rows(make: Callable[[], str]) -> None:
    urdf = make()
    scene_free = list_moving_joints(urdf)
    tool = _last_link(urdf)
    kinematics = Kinematics(urdf, scene_free, tool)
    arm, torques = ArmTree(kinematics, GRAVITY), LinkTorques(urdf, scene_free, GRAVITY)
    rng = np.random.default_rng(0)
    q, v, a = rng.normal(size=(3, 5, len(scene_free)))
    p, R = arm.compute_tool_poses(q)
    tau = arm.compute_torques(q, v, a)
    for k in range(5):
        R_WT, p_WT = kinematics.forward(q[k])
        np.testing.assert_allclose(p[k], p_WT, atol=1e-12)
        np.testing.assert_allclose(R[k], R_WT, atol=1e-12)
        np.testing.assert_allclose(
            tau[k], torques.compute_torques(q[k], v[k], a[k]), rtol=1e-9, atol=1e-9
        )


def test_a_trace_goes_through_its_poses() -> None:
    scene = load_scene("manutec_r3")
    kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    arm = ArmTree(kinematics)
    start = np.array([-0.5, 0.6, 1.4, 0.3, -1.2, 0.2])
    R_WT, p_WT = kinematics.forward(start)
    p = p_WT + np.linspace(0.0, 1.0, 21)[1:, None] * [0.1, -0.05, 0.1]
    q = arm.trace_poses(start, p, np.repeat(R_WT[None], 20, axis=0))
    np.testing.assert_array_equal(q[0], start)
    np.testing.assert_allclose(arm.compute_tool_poses(q[1:])[0], p, atol=1e-9)


def _last_link(urdf: str) -> str:
    import xml.etree.ElementTree as ET

    robot = ET.fromstring(urdf.encode())
    parents = {element.get("link") for element in robot.iter("parent") if element.get("link")}
    return next(
        element.get("name", "")
        for element in robot.findall("link")
        if element.get("name") not in parents
    )
