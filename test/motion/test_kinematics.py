"""Kinematics: against first principles, differences, and the names of joints."""

import math
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from kinematic_arms import (
    NAMES,
    THREE_AXIS,
    arm,
    bent,
    chain,
    moved,
    pose_at,
    three_axis,
    turning_chain,
)
from machines import write_random_chain
from scipy.spatial.transform import Rotation

from arm_emulator import JacobianController, Kinematics, Pose, Refusal, load_scene
from arm_emulator.base.urdf.urdf_text import read_urdf
from arm_emulator.machine.scene.urdf_file import find_example_robot_data
from arm_emulator.motion.model.link_motions import LinkMotions


def test_forward_kinematics_of_the_three_axis_arm() -> None:
    """Written from Fig. 3: two rods of 0.3 m in a vertical plane that the waist turns."""
    rng = np.random.default_rng(1)
    kinematics = three_axis().kinematics
    for waist, shoulder, elbow in rng.uniform(-3, 3, (20, 3)):
        out = 0.3 * math.sin(shoulder) + 0.3 * math.sin(shoulder + elbow)
        up = 0.3 + 0.3 * math.cos(shoulder) + 0.3 * math.cos(shoulder + elbow)
        R_WT, p_WT = kinematics.forward([waist, shoulder, elbow])
        expected = [out * math.cos(waist), out * math.sin(waist), up]
        assert np.allclose(p_WT, expected, rtol=0, atol=1e-14)  # m, rounding
        turn = Rotation.from_euler("ZY", [waist, shoulder + elbow]).as_matrix()
        assert np.allclose(R_WT, turn, rtol=0, atol=1e-14)


@pytest.mark.parametrize("joints", [1, 3, 6, 7, 12])
@pytest.mark.parametrize("seed", range(3))
def test_jacobian_is_the_derivative_of_forward_kinematics(joints: int, seed: int) -> None:
    """Random joints of every kind about random axes, against central differences."""
    rng = np.random.default_rng([joints, seed])
    urdf = write_random_chain(rng, joints)
    names = [
        f"{kind}_{i}"
        for i in range(joints)
        for kind in ("revolute", "continuous", "prismatic")
        if f'<joint name="{kind}_{i}"' in urdf
    ]
    kinematics = Kinematics(urdf, names, f"{names[-1]}_link", task="pose")
    assert_jacobian(kinematics, rng.uniform(-2, 2, joints))


def assert_jacobian(kinematics: Kinematics, q: np.ndarray, robot: str = "") -> None:
    """Compare the Jacobian with central differences of forward kinematics."""
    J, h = kinematics.jacobian(q), 1e-6
    for j, step in enumerate(h * np.eye(len(q))):
        R_plus, p_plus = kinematics.forward(q + step)
        R_minus, p_minus = kinematics.forward(q - step)
        turn = Rotation.from_matrix(R_plus @ R_minus.T).as_rotvec()
        difference = np.concatenate([p_plus - p_minus, turn]) / (2 * h)
        # Central differences: h^2 of truncation and 1e-16 / h of rounding.
        assert np.allclose(J[:, j], difference, rtol=0, atol=1e-8), (robot, j)


def longest_chain(file: Path) -> tuple[list[str], str]:
    """Joints from the root of a robot to the link with the most moving ones above it."""
    above = {}
    for joint in ET.parse(file).getroot().findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        assert parent is not None and child is not None
        above[child.get("link", "")] = joint, parent.get("link", "")
    best: tuple[list[str], str] = [], ""
    for tool in above:
        names, link = [], tool
        while link in above:
            joint, link = above[link]
            if joint.get("type") in ("revolute", "continuous", "prismatic"):
                names.append(joint.get("name", ""))
        if len(names) > len(best[0]):
            best = names[::-1], tool
    return best


@pytest.mark.slow
@pytest.mark.skipif(
    find_example_robot_data() is None, reason="needs the package example-robot-data"
)
def test_jacobians_of_published_robots_are_the_derivatives_of_their_forward_kinematics() -> None:
    folder = find_example_robot_data()
    assert folder is not None
    rng, robots = np.random.default_rng(11), 0
    for file in sorted(folder.rglob("*.urdf")):
        names, tool = longest_chain(file)
        try:
            kinematics = Kinematics(read_urdf(file), names, tool, "pose")
        except Refusal:
            continue  # no moving joint, or more than a chain: reported in other tests
        robots += 1
        for _ in range(3):
            q = rng.uniform(np.maximum(kinematics.lower, -3.0), np.minimum(kinematics.upper, 3.0))
            assert_jacobian(kinematics, q, file.name)
            error, same = kinematics.compute_error_and_jacobian(
                q, Pose(*kinematics.forward(q)[::-1])
            )
            assert np.array_equal(same, kinematics.jacobian(q)), file.name
            assert np.abs(error).max() < 1e-15, file.name
    assert robots >= 60, f"{robots} robots only"


def test_joints_are_matched_by_name() -> None:
    forth, back = (
        arm(6),
        JacobianController(Kinematics(turning_chain(6), [f"j{i}" for i in range(6)][::-1], "tool")),
    )
    q = bent(6)
    assert np.array_equal(forth.kinematics.jacobian(q)[:, ::-1], back.kinematics.jacobian(q[::-1]))
    target = moved(pose_at(forth, q), np.full(6, 1e-3))
    # The singular value decomposition sums in another order.
    assert np.allclose(forth.update(q, target).q[::-1], back.update(q[::-1], target).q, atol=1e-13)


def test_joints_not_named_stay_at_their_neutral_position() -> None:
    q = bent(4)
    all_joints = chain(7, "position")
    some = Kinematics(turning_chain(7), [f"j{i}" for i in range(4)], "tool")
    expected = all_joints.forward(np.concatenate([q, np.zeros(3)]))
    assert np.allclose(some.forward(q)[1], expected[1], rtol=0, atol=1e-14)
    assert some.rows == 3


def test_task_follows_from_the_number_of_joints() -> None:
    assert [chain(n).rows for n in (3, 5, 6, 7)] == [3, 3, 6, 6]
    assert chain(7, "position").rows == 3
    assert chain(3, "pose").rows == 6


def test_base_and_reach() -> None:
    assert three_axis().kinematics.base == "base"
    assert three_axis().kinematics.reach == pytest.approx(0.9)
    on_a_post = THREE_AXIS.replace(
        '<parent link="base"/>', '<origin xyz="0 0 2"/><parent link="base"/>'
    )
    assert Kinematics(on_a_post, NAMES, "tool").forward(np.zeros(3))[1][2] > 1.9, "a post of 2 m"
    assert Kinematics(on_a_post, NAMES, "tool").reach == pytest.approx(0.9), "it reaches no farther"


def test_limits_of_the_description_are_taken() -> None:
    """Random limits of speed and acceleration, given or not, of joints of every kind."""
    rng = np.random.default_rng(5)
    for _ in range(50):
        urdf, expected = THREE_AXIS, []
        for name in NAMES:
            kind = str(rng.choice(["continuous", "revolute", "prismatic"]))
            inputs = {
                key: float(rng.choice([0.0, rng.uniform(0.1, 20.0)]))
                for key in ("velocity", "acceleration")
                if rng.random() < 0.7
            }
            if kind != "continuous" and rng.random() < 0.5:
                inputs.update(lower=-1.5, upper=2.5)
            words = " ".join(f'{key}="{value!r}"' for key, value in inputs.items())
            start = urdf.index(f'<joint name="{name}"')
            end = urdf.index("</joint>", start)
            urdf = f"{urdf[:end]}<limit effort='1' {words}/>{urdf[end:]}"
            urdf = urdf.replace(f'name="{name}" type="continuous"', f'name="{name}" type="{kind}"')
            expected.append([inputs.get(key) or math.inf for key in ("velocity", "acceleration")])
        kinematics = Kinematics(urdf, NAMES, "tool")
        result = np.stack([kinematics.velocity_limit, kinematics.acceleration_limit], axis=1)
        assert np.array_equal(result, expected), urdf


@pytest.mark.parametrize("value", ["-1", "nan", "fast"])
@pytest.mark.parametrize("key", ["velocity", "acceleration"])
def test_malformed_limits_are_refused(key: str, value: str) -> None:
    urdf = THREE_AXIS.replace("</joint>", f'<limit {key}="{value}"/></joint>', 1)
    with pytest.raises(Refusal, match=f"joint waist: limit {key} must be a number >= 0"):
        Kinematics(urdf, NAMES, "tool")


H = 1e-6  # s, of central differences: rounding 1e-10, their own error below


@pytest.mark.parametrize("name", ["three_axis", "panda"])
def test_speeds_are_derivatives_and_the_tool_is_where_the_controller_has_it(name: str) -> None:
    rng, scene = np.random.default_rng(3), load_scene(name)
    links = LinkMotions(scene.urdf, scene.joint_names)
    kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    for _ in range(10):
        q, v = rng.uniform(-1.5, 1.5, (2, len(scene.joints)))
        poses = {}
        for sign in (-1, 1):
            links.place_links(q + sign * H * v, v)
            poses[sign] = {link: links.get_pose(link) for link in links.names}
        links.place_links(q, v)
        for link in links.names:
            (p0, o0), (p1, o1) = poses[-1][link], poses[1][link]
            linear, angular = links.get_twist(link)
            assert np.abs((p1 - p0) / (2 * H) - linear).max() < 1e-8
            o = links.get_pose(link)[1]
            rate = (o1 * np.sign(o1 @ o) - o0 * np.sign(o0 @ o)) / (2 * H)
            # The quaternion's rate is half the product of (omega, 0) and itself.
            expected = 0.5 * np.append(o[3] * angular + np.cross(angular, o[:3]), -angular @ o[:3])
            assert np.abs(rate - expected).max() < 1e-8
        if scene.tool in links.names:
            _, p_WT = kinematics.forward(q)
            assert np.abs(links.get_pose(scene.tool)[0] - p_WT).max() < 1e-12
