"""The links against Pinocchio: M(q) a + nle(q, v) = tau."""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from draws import some, with_slow
from machines import GRAVITY, Oracle, links_of, random_chain
from scipy.spatial.transform import Rotation

from arm_emulator import Plant, Scene, load_scene
from arm_emulator.machine.plant.link_dynamics import LinkDynamics
from arm_emulator.machine.scene.urdf_chain import lock_joints
from arm_emulator.machine.scene.urdf_file import find_example_robot_data

needs_robots = pytest.mark.skipif(
    find_example_robot_data() is None, reason="needs the package example-robot-data (make robots)"
)

STATES = 1000
# Both sides lose about cond(M) units of the last place, and cond(M) < 1e5 here.
TOLERANCE = 1e-10


def worst_error(scene: Scene, links: LinkDynamics, seed: int) -> float:
    """Largest relative difference of accelerations over random states."""
    oracle, rng = Oracle(scene), np.random.default_rng(seed)
    shape = (STATES, len(scene.joints))
    q, v = rng.uniform(-np.pi, np.pi, shape), rng.normal(0.0, 3.0, shape)
    tau = rng.normal(0.0, 30.0, shape)
    a = links.accelerations(q, v, tau)
    expected = np.array([oracle.aba(*row) for row in zip(q, v, tau, strict=True)])
    error = np.linalg.norm(a - expected, axis=1) / np.linalg.norm(expected, axis=1)
    return float(error.max())


@pytest.mark.parametrize(
    "name",
    some(
        [
            "three_axis",
            pytest.param("ur5", marks=needs_robots),
            pytest.param("panda", marks=needs_robots),
        ],
        2,
    ),
)
def test_shipped_scenes_equal_aba(name: str) -> None:
    scene = load_scene(name)
    assert worst_error(scene, Plant(scene).links, seed=1) < TOLERANCE, "accelerations, relative"


# 12 are the most that the core unrolls in nested loops, which a compiler takes long over.
@pytest.mark.parametrize(
    ("seed", "joints"), with_slow(some([(3, 5), (6, 14), (1, 1), (2, 2), (5, 7), (4, 12)], 2), 1)
)
def test_random_chains_equal_aba(tmp_path: Path, seed: int, joints: int) -> None:
    """Revolute and prismatic joints about any axis, fixed joints merged, gravity aslant.

    14 joints lie beyond the core's limit of unrolling.
    """
    scene = random_chain(tmp_path, seed, joints, gravity=GRAVITY)
    assert worst_error(scene, links_of(scene), seed) < TOLERANCE, "accelerations, relative"


def test_payload_is_a_body_at_the_tool(tmp_path: Path) -> None:
    mass, com, moments = 2.5, [0.1, -0.2, 0.3], [0.1, 0.2, 0.15, 0.01, 0.02, -0.03]
    payload = {"mass": mass, "com": com, "inertia": moments}
    scene = random_chain(tmp_path, 7, 2, gravity=[0, 0, -9.81])
    tool = f"{scene.joint_names[-1]}_link"
    loaded = load_scene(tmp_path / "scene.yaml", overrides={"payload": payload, "tool": tool})
    oracle, rng = Oracle(scene), np.random.default_rng(7)
    xx, yy, zz, xy, xz, yz = moments
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    body = pin.Inertia(mass, np.array(com), inertia)
    frame = oracle.model.frames[oracle.model.getFrameId(tool)]
    oracle.model.appendBodyToJoint(frame.parentJoint, body, frame.placement)
    oracle.data = oracle.model.createData()
    q, v, tau = rng.normal(size=(3, 2))
    expected = oracle.aba(q, v, tau)
    actual = links_of(loaded).accelerations(q, v, tau)
    assert actual == pytest.approx(expected, rel=TOLERANCE), "accelerations with a payload"


@pytest.mark.slow
@pytest.mark.parametrize("seed", some(range(4), 1))
def test_locked_joints_hold_their_position(tmp_path: Path, seed: int) -> None:
    """Two of five joints, anywhere in the chain: Pinocchio locks them there too."""
    rng = np.random.default_rng([seed, 5])
    full = random_chain(tmp_path, seed, 5, gravity=GRAVITY)
    locked = {str(name): float(rng.normal()) for name in rng.choice(full.joint_names, 2, False)}
    overrides = {"locked": locked} | {f"joints.{name}": None for name in locked}
    scene = load_scene(tmp_path / "scene.yaml", overrides=overrides)
    oracle = Oracle(full)
    at = oracle.configuration(np.array([locked.get(name, 0.0) for name in full.joint_names]))
    places = [oracle.model.getJointId(name) for name in locked]
    q, v, tau = rng.normal(size=(3, 3))
    reduced = Oracle(scene)
    reduced.model = pin.buildReducedModel(oracle.model, places, at)
    reduced.data = reduced.model.createData()
    expected = pytest.approx(reduced.aba(q, v, tau), rel=TOLERANCE)
    assert links_of(scene).accelerations(q, v, tau) == expected, "accelerations by the core"
    assert Oracle(scene).aba(q, v, tau) == expected, "accelerations by the tests' oracle"


def test_locked_joints_near_a_quarter_turn_stand_where_they_are_locked() -> None:
    """Roll and yaw in the published URDF hardly differ there; the frame must stay exact.

    In SciPy's rotations, with pitches that are 1e-15 to 0.1 rad from a quarter of a turn.
    """
    rng = np.random.default_rng(9)
    for _ in range(1000):
        axis, angle = rng.normal(size=3), float(rng.uniform(-3.0, 3.0))
        turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
        pitch = rng.choice([-1.0, 1.0]) * (0.5 * np.pi - 10.0 ** rng.uniform(-15.0, -1.0))
        yaw, roll = rng.uniform(-3.0, 3.0, 2)
        expected = Rotation.from_euler("ZYX", [yaw, pitch, roll])
        rpy = (expected * turn.inv()).as_euler("ZYX")[::-1]
        robot = ET.fromstring(
            f"""<robot name="one"><link name="base"/><link name="tool"/>
            <joint name="joint" type="continuous"><parent link="base"/><child link="tool"/>
            <origin rpy="{" ".join(map(repr, rpy.tolist()))}"/>
            <axis xyz="{" ".join(map(repr, axis.tolist()))}"/></joint></robot>"""
        )
        lock_joints(robot, {"joint": angle}, "one.urdf")
        written = np.fromstring(robot.find("joint/origin").get("rpy"), sep=" ")
        actual = Rotation.from_euler("ZYX", written[::-1]).as_matrix()
        # A product of three turns, each rounded.
        assert np.abs(actual - expected.as_matrix()).max() < 2e-15, f"pitch {pitch!r}"
