"""Pose accuracy by ISO 9283, and the true kinematics from measured poses of the tool."""

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from draws import with_slow
from machines import own_three_axis
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from arm_emulator import Refusal, load_scene
from arm_emulator.runs.gains import load_gains
from arm_emulator_identification.calibration.accuracy import AccuracyTest, measure_accuracy
from arm_emulator_identification.calibration.drawn_deviations import draw_deviations
from arm_emulator_identification.calibration.iso_9283 import (
    compute_direction_deviation,
    judge_pose,
    place_poses,
)
from arm_emulator_identification.calibration.led_arm import LedArm, ToolRest, measure_pose
from arm_emulator_identification.calibration.pose_fit import (
    PRIOR,
    PoseModel,
    compare_poses,
    fit_poses,
)
from arm_emulator_identification.commands.accuracy import compare_accuracy
from oracles.random_chain import list_moving_joints, write_random_chain, write_random_tree

CENTRE = 0.3, 0.1, 0.5  # m, amid the reach of the three-axis arm
EXACT = 1e-9  # m and rad: noise that leaves the prior without effect


class DisplacedArm:
    """An arm in Pinocchio with joints displaced by twists in their frames."""

    def __init__(self, urdf: str, joints: list[str], tool: str) -> None:
        robot = ET.fromstring(urdf)
        for joint in robot.iter("joint"):
            if joint.get("type") == "continuous":
                joint.set("type", "revolute")
        self.model = pin.buildModelFromXML(ET.tostring(robot, encoding="unicode"))
        self.data = self.model.createData()
        self.places = [self.model.idx_qs[self.model.getJointId(name)] for name in joints]
        self.frame = self.model.getFrameId(tool)
        self.nominal = [pin.SE3(place) for place in self.model.jointPlacements]
        self.mount = pin.SE3(self.model.frames[self.frame].placement)

    def displace(self, twists: dict[str, np.ndarray]) -> None:
        """Displace joints by (p, rotation vector); `mount` is the tool's."""
        for k, place in enumerate(self.nominal):
            self.model.jointPlacements[k] = place * _se3(twists.get(self.model.names[k]))
        self.model.frames[self.frame].placement = self.mount * _se3(twists.get("mount"))

    def place(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        configuration = pin.neutral(self.model)
        configuration[self.places] = q
        pin.framesForwardKinematics(self.model, self.data, configuration)
        at = self.data.oMf[self.frame]
        return at.rotation.copy(), at.translation.copy()


def _se3(twist: np.ndarray | None) -> pin.SE3:
    if twist is None:
        return pin.SE3.Identity()
    return pin.SE3(Rotation.from_rotvec(twist[3:]).as_matrix(), twist[:3])


def random_arm(seed: int) -> tuple[str, list[str], str]:
    """Turning and sliding joints, also on branches; the tool is fixed to the last one."""
    rng = np.random.default_rng(seed)
    make = (write_random_chain, write_random_tree)[seed % 2]
    urdf = make(rng, int(rng.integers(2, 7)))
    names = list_moving_joints(urdf)
    mount = (
        f'<joint name="mount" type="fixed"><origin xyz="0.1 -0.2 0.15" rpy="0.3 0.2 0.1"/>'
        f'<parent link="{names[-1]}_link"/><child link="tool"/></joint><link name="tool"/></robot>'
    )
    return urdf.replace("</robot>", mount), names, "tool"


def displaced_rests(
    arm: DisplacedArm, names: list[str], rng: np.random.Generator, count: int
) -> list[ToolRest]:
    rows = rng.uniform(-1.5, 1.5, (count, len(names)))
    return [ToolRest(q, *arm.place(q)) for q in rows]


@pytest.mark.parametrize("seed", range(12))
def test_true_kinematics_follows_from_exact_poses(seed: int) -> None:
    """Other poses than those of the fit are met, and the count of what acts is the theory's."""
    urdf, names, tool = random_arm(seed)
    model, rng = PoseModel(urdf, names, tool), np.random.default_rng(100 + seed)
    arm = DisplacedArm(urdf, names, tool)
    moved = [joint.name for joint in model.displaced]
    arm.displace(
        {
            name: np.concatenate([rng.normal(0.0, 1e-3, 3), rng.normal(0.0, 5e-3, 3)])
            for name in moved
        }
    )
    rests = displaced_rests(arm, names, rng, 40)
    fit = fit_poses(model, rests, (EXACT, EXACT))
    checked = displaced_rests(arm, names, rng, 20)
    before, after = (
        compare_poses(model, {}, checked),
        compare_poses(model, fit.displacements, checked),
    )
    assert before[0].max() > 1e-3 and before[1].max() > 1e-3
    assert after[0].max() < 1e-7 and after[1].max() < 1e-7, "what the prior takes from 1e-9"
    kinds = [joint.kind for joint in model.path.moving]
    sliding = kinds.count("prismatic")
    expected = 4 * (len(kinds) - sliding) + 2 * sliding + 6
    assert (fit.count, fit.rank) == (6 * (len(kinds) + 1), expected)
    assert len(fit.alike) == fit.count - fit.rank


@pytest.mark.parametrize("oriented", [True, False])
@pytest.mark.parametrize("seed", with_slow([21, 0, 3, 4], 1))
def test_noisy_poses_are_fitted_as_by_scipy(seed: int, oriented: bool) -> None:
    """The same sum of squares, written by the test on Pinocchio, has its minimum there."""
    urdf, names, tool = random_arm(seed)
    model, rng = PoseModel(urdf, names, tool), np.random.default_rng(200 + seed)
    arm = DisplacedArm(urdf, names, tool)
    moved = [joint.name for joint in model.displaced]
    arm.displace({name: rng.normal(0.0, 2e-3, 6) for name in moved})
    sigma = 2e-5, 2e-4 if oriented else np.inf
    exact = displaced_rests(arm, names, rng, 30)
    rests = [measure_pose(pose, sigma[0], 2e-4, rng) for pose in exact]

    def residual(x: np.ndarray) -> np.ndarray:
        arm.displace(dict(zip(moved, x.reshape(-1, 6), strict=True)))
        rows = [x / np.tile(PRIOR, len(moved))]
        for rest in rests:
            R, p = arm.place(rest.q)
            rows.append((rest.p - p) / sigma[0])
            rows.append(Rotation.from_matrix(rest.R @ R.T).as_rotvec() / sigma[1])
        return np.concatenate(rows)

    expected = least_squares(residual, np.zeros(6 * len(moved)), x_scale="jac", xtol=1e-14)
    fit = fit_poses(model, rests, sigma)
    twists = np.concatenate(
        [
            np.concatenate([displacement.p, Rotation.from_matrix(displacement.R).as_rotvec()])
            for displacement in fit.displacements.values()
        ]
    )
    assert 0.5 * np.sum(residual(twists) ** 2) == pytest.approx(expected.cost, rel=1e-5)
    checked = displaced_rests(arm_at(arm, moved, expected.x), names, rng, 10)
    off, turned = compare_poses(model, fit.displacements, checked)
    assert off.max() < 1e-7, "far below the noise of the poses"
    assert not oriented or turned.max() < 1e-6, "positions alone do not show how the tool is turned"


def arm_at(arm: DisplacedArm, moved: list[str], x: np.ndarray) -> DisplacedArm:
    arm.displace(dict(zip(moved, x.reshape(-1, 6), strict=True)))
    return arm


def test_shifts_along_parallel_axes_are_named() -> None:
    """Of two joints in a plane the shifts along both axes."""
    text = '<robot name="planar"><link name="base"/>'
    for name, parent, x in (("one", "base", 0.0), ("two", "one_link", 0.5)):
        text += (
            f'<joint name="{name}" type="revolute"><origin xyz="{x} 0 0"/><axis xyz="0 0 1"/>'
            f'<parent link="{parent}"/><child link="{name}_link"/>'
            '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
            f'<link name="{name}_link"/>'
        )
    model = PoseModel(text + "</robot>", ["one", "two"], "two_link")
    rng = np.random.default_rng(0)
    arm = DisplacedArm(text + "</robot>", ["one", "two"], "two_link")
    fit = fit_poses(model, displaced_rests(arm, ["one", "two"], rng, 30), (1e-5, 1e-4))
    # The base 6, the second axis 4 in the first link's frame; two zeros are one each of these. The
    # tool has no mount of its own, so that its 6 are the second joint's.
    assert fit.count == 12
    heights = {"one.z", "two.z"}
    alone = next(name for name in fit.alike if name in heights)
    assert set(fit.alike[alone]) == heights - {alone}


def test_characteristics_have_the_closed_form() -> None:
    """Four positions on the corners of a tetrahedron, and two on a line."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * 1e-3
    command = np.eye(3), np.array([0.0, 0.0, 2e-3])
    rotations = np.tile(Rotation.from_rotvec([0.0, 1e-3, 0.0]).as_matrix(), (4, 1, 1))
    result = judge_pose(command, corners, rotations)
    assert result.AP == pytest.approx(2e-3)
    assert result.RP == pytest.approx(np.sqrt(3) * 1e-3), "all are as far from the barycentre"
    assert result.AP_abc == pytest.approx((0.0, 1e-3, 0.0), abs=1e-15)
    assert result.RP_abc == pytest.approx((0.0, 0.0, 0.0), abs=1e-15)
    line = np.array([[0.0, 0, 0], [0.0, 0, 0], [3e-3, 0, 0]])  # distances 1, 1, 2 mm
    line_result = judge_pose((np.eye(3), np.zeros(3)), line, np.tile(np.eye(3), (3, 1, 1)))
    assert line_result.RP == pytest.approx((4.0 / 3.0 + 3.0 * np.sqrt(1.0 / 3.0)) * 1e-3)
    assert compute_direction_deviation(
        [corners, corners + np.array([0.0, 3e-3, 0.0])]
    ) == pytest.approx(3e-3)


def test_poses_lie_on_a_diagonal_plane_of_the_cube() -> None:
    centre, edge = np.array([0.3, -0.2, 0.5]), 0.4
    poses = place_poses(centre, edge)
    assert poses[0] == pytest.approx(centre)
    normal = np.array([1.0, 0.0, -1.0]) / np.sqrt(2.0)
    assert (poses - centre) @ normal == pytest.approx(np.zeros(5), abs=1e-15)
    diagonal = np.sqrt(3.0) * edge
    for p in poses[1:]:
        corner = centre + 0.5 * edge * np.sign(p - centre)
        assert np.linalg.norm(corner - p) == pytest.approx(0.1 * diagonal)


@pytest.fixture
def accuracy_test() -> AccuracyTest:
    return AccuracyTest(cycles=3, centre=CENTRE, edge=0.16, dwell=0.3, directions=False, poses=25,
                        held=8, tracker=15e-6, tracker_angle=np.inf, seed=1)  # fmt: skip


def test_a_calibrated_controller_reaches_its_poses(
    tmp_path: Path, accuracy_test: AccuracyTest
) -> None:
    """As near as without deviations, up to the fit's accuracy; before it misses by millimetres."""
    file = own_three_axis(tmp_path, "")
    scene, gains = load_scene(file), load_gains(file)
    joints = PoseModel(scene.urdf, scene.joint_names, scene.tool).displaced
    deviations = draw_deviations(joints, np.random.default_rng(5))
    numbers = {name: deviation.nonzero for name, deviation in deviations.items()}
    numbers["elbow"] |= {"encoder_zero": 2e-3}
    deviating = load_scene(file, {"calibration": {"joints": numbers}})
    out = tmp_path / "found.yaml"
    stages: list[str] = []
    edge, before, calibrated, after = measure_accuracy(
        deviating, gains, accuracy_test, stages.append, out
    )
    assert stages == ["cube", "before", "random poses", "after"]
    assert edge == pytest.approx(accuracy_test.edge)
    assert calibrated is not None and after is not None
    sound = measure_accuracy(scene, gains, replaced(accuracy_test, poses=0), stages.append, out)[1]
    assert before.AP > 1e-3, "deviations of published size"
    # 25 poses with 15 um per axis: their mean error is a third of it in each of three axes.
    assert abs(after.AP - sound.AP) < 3e-5
    assert calibrated.before[0].max() > 1e-3
    assert np.sqrt(np.mean(calibrated.after[0] ** 2)) < 5e-5, "the tracker's noise: 26 um in space"
    assert before.RP < 1e-4 and after.RP < 1e-4, "the class of such arms"


def replaced(accuracy_test: AccuracyTest, **values: Any) -> AccuracyTest:
    return AccuracyTest(**{**accuracy_test.__dict__, **values})


def test_motion_control_takes_the_place_of_links_by_counts_and_wind_up(tmp_path: Path) -> None:
    """At rest those that go to the fit are the links', up to counts and friction."""
    file = own_three_axis(tmp_path, "")
    scene, gains = load_scene(file), load_gains(file)
    arm = LedArm(scene, gains, dwell=0.5)
    rest = arm.move_tool(arm.compute_pose(scene.start + np.array([0.2, 0.1, -0.1])))
    assert rest is not None
    assert rest.q == pytest.approx(arm.run.session.state.q, abs=2e-4)


@pytest.mark.slow
def test_the_command_prints_its_measurements(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = own_three_axis(tmp_path, "")
    out = tmp_path / "found.yaml"
    code = compare_accuracy(
        str(file), cycles=2, centre=CENTRE, edge=0.1, dwell=0.2, draw=3, fit=12, held=3,
        positions=True, out=out,
    )  # fmt: skip
    text = capsys.readouterr().out
    assert code == 0
    for words in (
        "2 cycles of 5 poses in a cube of 0.1 m",
        "before the calibration",
        "after the calibration",
        "3 held poses, after",
        "cannot be distinguished",
    ):
        assert words in text  # fmt: skip
    assert load_scene(file, {"calibration": {"file": out.name}}).calibration.deviations
    calibrated = own_three_axis(
        tmp_path / "calibrated", "calibration: {joints: {elbow: {x: 1e-3}}}\n"
    )
    with pytest.raises(Refusal, match="--draw must stand with a scene without calibration"):
        compare_accuracy(str(calibrated), draw=1)
    for keys, words in (
        ({"cycles": 1}, "--cycles must be a whole number"),
        ({"edge": 0.0}, "--edge must be a number > 0"),
        ({"fit": 5, "out": tmp_path / "a.txt"}, "--out must end in .yaml"),
        ({"edge": 5.0, "cycles": 2}, "--edge must leave five poses about the centre"),
        ({"centre": (9.0, 0.0, 0.0), "cycles": 2}, "--centre must have a cube of 0.1 m about it"),
    ):
        with pytest.raises(Refusal, match=words):
            compare_accuracy(str(file), **keys)  # type: ignore[arg-type]
