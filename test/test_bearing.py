"""Bearings that give way: closed forms, modes by Pinocchio and SciPy, energy, what doors show."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from machines import write_scene
from scipy.optimize import brentq

from arm_emulator import Plant, Refusal, Scene, linearise, load_scene

MASS, LENGTH, INERTIA = 2.0, 0.4, (0.02, 0.03, 0.05)  # kg, m, kg m2 about the centre of mass
GRAVITY = 9.81  # m/s2
MOTOR = {"kind": "torque", "rotor_inertia": 1e-3}
SPRINGS = {
    "shift_x": {"stiffness": 4e4, "damping": 8.0},
    "shift_z": {"stiffness": 3e4, "damping": 6.0},
    "tilt_x": {"stiffness": 900.0, "damping": 4.0},
    "tilt_y": {"stiffness": 700.0, "damping": 3.0},
}
UPPER = {"shift_y": {"stiffness": 5e4}, "tilt_x": {"stiffness": 400.0, "damping": 0.1}}
OFFSET, LEAN = (0.5, 0.1, 0.2), 0.3  # of the second joint in the first link [m], about x [rad]
AXES = {"x": 0, "y": 1, "z": 2}


def arm_urdf(joints: int, kind: str = "continuous", axis: str = "0 0 1") -> str:
    """Links that turn about z of their frames, each with its body along x."""
    text = ["<robot name='arm'><link name='base'/>"]
    for k in range(joints):
        xx, yy, zz = INERTIA
        xyz, rpy = (OFFSET, (LEAN, 0.0, 0.0)) if k else ((0.0,) * 3, (0.0,) * 3)
        text.append(
            f"<link name='link_{k}'><inertial><origin xyz='{LENGTH} 0 0'/><mass value='{MASS}'/>"
            f"<inertia ixx='{xx}' iyy='{yy}' izz='{zz}' ixy='0' ixz='0' iyz='0'/></inertial></link>"
            f"<joint name='joint_{k}' type='{kind}'>"
            f"<parent link='{f'link_{k - 1}' if k else 'base'}'/>"
            f"<child link='link_{k}'/><axis xyz='{axis}'/>"
            f"<origin xyz='{' '.join(map(str, xyz))}' rpy='{' '.join(map(str, rpy))}'/></joint>"
        )
    return "".join([*text, "</robot>"])


def make_scene(folder: Path, bearings: list[dict[str, Any]], **keys: Any) -> Scene:
    joints = {
        f"joint_{k}": {"motor": MOTOR, **({"bearing": bearing} if bearing else {})}
        for k, bearing in enumerate(bearings)
    }
    keys = {"integrator": {"scheme": "rosenbrock", "dt": 1e-4}, "energy_flow": True} | keys
    return load_scene(write_scene(folder, arm_urdf(len(bearings)), joints, **keys))


@pytest.fixture(scope="module")
def beam(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """A link about a vertical axis, whose weight bends its bearing."""
    return make_scene(
        tmp_path_factory.mktemp("beam"), [SPRINGS], gravity=[0.0, 0.0, -GRAVITY],
        varied=["joints.*.bearing.*"], external_wrench=True, tool="link_0",
    )  # fmt: skip


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Two links in bearings, without gravity."""
    return make_scene(tmp_path_factory.mktemp("arm"), [SPRINGS, UPPER])


def settle(plant: Plant) -> None:
    plant.advance(np.zeros(len(plant.scene.joints)), 200_000)


def list_deflections(plant: Plant) -> dict[str, float]:
    measured = plant.measured
    return {name: float(getattr(measured, f"bearing_{name}")[0]) for name in SPRINGS}


def test_weight_deflects_a_bearing_as_statics_say(beam: Scene) -> None:
    """The slowest motion, D / K of 0.5 ms and its mass, has died away after 20 s to rounding."""
    plant = Plant(beam)
    settle(plant)
    K = SPRINGS["tilt_y"]["stiffness"]
    moment = MASS * GRAVITY * LENGTH
    tilt = brentq(lambda angle: moment * np.cos(angle) - K * angle, 0.0, 1.0, xtol=1e-15)
    expected = {
        "shift_x": 0.0, "shift_z": -MASS * GRAVITY / SPRINGS["shift_z"]["stiffness"],
        "tilt_x": 0.0, "tilt_y": tilt,
    }  # fmt: skip
    for name, value in list_deflections(plant).items():
        # 1e-9 of the largest deflection: what the undriven joint's drift leaves.
        assert value == pytest.approx(expected[name], abs=1e-11), name
    assert plant.state.q == pytest.approx(0.0, abs=1e-12), "the joint itself does not move"


def test_a_varied_stiffness_is_that_of_each_machine(beam: Scene) -> None:
    plant = Plant(beam)
    plant.set_parameter("joints.joint_0.bearing.shift_z.stiffness", 6e4)
    settle(plant)
    assert list_deflections(plant)["shift_z"] == pytest.approx(-MASS * GRAVITY / 6e4, rel=1e-9)


def make_model(bearings: list[dict[str, Any]]) -> tuple[pin.Model, np.ndarray, np.ndarray]:
    """Return Pinocchio's model of the same arm, stiffnesses and dampings of its joints."""
    model, parent, K, D = pin.Model(), 0, [], []
    for k, bearing in enumerate(bearings):
        R = pin.rpy.rpyToMatrix(LEAN if k else 0.0, 0.0, 0.0)
        place = pin.SE3(R, np.array(OFFSET if k else (0.0,) * 3))
        parent = model.addJoint(parent, pin.JointModelRZ(), place, f"joint_{k}")
        K, D = [*K, 0.0], [*D, 0.0]
        for name in sorted(bearing):  # shifts before tilts
            kind = {
                "shift": pin.JointModelPrismaticUnaligned,
                "tilt": pin.JointModelRevoluteUnaligned,
            }
            axis = np.eye(3)[AXES[name[-1]]]
            joint = kind[name.partition("_")[0]](axis)
            parent = model.addJoint(parent, joint, pin.SE3.Identity(), f"{k}.{name}")
            K, D = [*K, bearing[name]["stiffness"]], [*D, bearing[name].get("damping", 0.0)]
        body = pin.Inertia(MASS, np.array([LENGTH, 0.0, 0.0]), np.diag(INERTIA))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    return model, np.array(K), np.array(D)


def test_modes_are_those_of_pinocchio_s_mass_matrix(arm: Scene) -> None:
    """Eigenvalues of the linear machine against those of M q'' + D q' + K q = 0."""
    pose = np.array([0.4, -0.7])
    linear = linearise(Plant(arm), pose)
    model, K, D = make_model([SPRINGS, UPPER])
    q = np.zeros(model.nq)
    places = arm.joint_places
    q[places] = pose
    M = pin.crba(model, model.createData(), q)
    M = np.triu(M) + np.triu(M, 1).T
    M[places, places] += MOTOR["rotor_inertia"]
    n = len(M)
    expected = np.linalg.eigvals(
        np.block([[np.zeros((n, n)), np.eye(n)],
                  [-np.linalg.solve(M, np.diag(K)), -np.linalg.solve(M, np.diag(D))]])
    )  # fmt: skip
    actual = np.linalg.eigvals(linear.A)
    assert len(actual) == 2 * n == 16
    for found in (expected, actual):
        assert (found.imag > 1.0).sum() == 6, "each deflection swings"
    by_size = lambda z: np.sort_complex(z[z.imag > 1.0])  # noqa: E731
    # Both are solved by LAPACK from matrices of condition 1e6; the core's slopes are exact.
    assert by_size(actual) == pytest.approx(by_size(expected), rel=1e-9)
    assert (linear.q, linear.v, linear.B.shape) == (slice(0, 2), slice(2, 4), (16, 2))
    assert linear.x0[linear.q] == pytest.approx(pose)


def test_motion_keeps_its_energy_and_dampers_take_it(arm: Scene) -> None:
    plant = Plant(arm)
    plant.reset([0.3, -0.4], [2.0, 3.0])
    before = plant.energy
    flow = plant.advance_metered(np.zeros(2), 20_000)
    assert flow.dissipated[0] > 0.01 * before, "the test is of something"
    lost = before - plant.energy
    # Of second order in steps of 0.1 ms of modes below 300 Hz.
    assert lost == pytest.approx(flow.dissipated.sum() - flow.supplied.sum(), rel=2e-3)


def test_a_saved_machine_continues_to_the_bit(beam: Scene) -> None:
    plant = Plant(beam)
    plant.reset(v=[3.0])
    plant.advance([0.2], 777)
    saved, other = plant.save(), Plant(beam)
    other.restore(saved)
    twin = copy.copy(plant)
    for one in (plant, other, twin):
        one.advance([0.1], 1234)
    q = [one.machine_motion for one in (plant, other, twin)]
    assert np.array_equal(q[0], q[1]) and np.array_equal(q[0], q[2])
    plant.reset()
    assert not np.any(plant.machine_motion), "a reset straightens the bearing"


def test_one_call_and_many_give_the_same_bits(beam: Scene) -> None:
    commands = np.random.default_rng(3).normal(size=(50, 1))
    one, many = Plant(beam), Plant(beam)
    q = one.run(commands, 7)
    rows = []
    for command in commands:
        many.advance(command, 7)
        rows.append(many.state.q)
    assert np.array_equal(q, rows)
    assert np.array_equal(one.machine_motion, many.machine_motion)


def test_a_wrench_acts_on_the_body_behind_the_bearing(beam: Scene) -> None:
    from arm_emulator import ExternalWrench

    plant, force = Plant(beam), 50.0
    plant.set_external_wrench("link_0", ExternalWrench((0.0, 0.0, force), axes="world"))
    settle(plant)
    expected = (force - MASS * GRAVITY) / SPRINGS["shift_z"]["stiffness"]
    assert list_deflections(plant)["shift_z"] == pytest.approx(expected, rel=1e-8)
    assert list(plant.external_wrenches) == ["link_0"]
    with pytest.raises(Refusal, match=r"be one that moves, got joint_0\.bearing\.tilt_x"):
        plant.set_external_wrench("joint_0.bearing.tilt_x", ExternalWrench())


def test_controllers_see_their_joints_alone(arm: Scene) -> None:
    plant = Plant(arm)
    assert arm.joint_names == ("joint_0", "joint_1")
    assert plant.state.q.shape == plant.measured.encoder_counts.shape == (2,)
    assert "bearing" not in arm.urdf
    assert list(arm.machine_joints) == [
        "joint_0", *(f"joint_0.bearing.{name}" for name in SPRINGS),
        "joint_1", *(f"joint_1.bearing.{name}" for name in UPPER),
    ]  # fmt: skip
    plant.advance([1.0, 1.0], 100)
    q, _ = plant.machine_motion
    deflections = plant.measured
    assert deflections.bearing_tilt_x == pytest.approx(q[[3, 7]], abs=0.0)
    assert deflections.bearing_shift_y == pytest.approx([0.0, q[6]], abs=0.0)
    assert (q[arm.joint_places] == plant.state.q).all()
    assert plant.core.arm_describe  # a joint's number in C is that of the controllers


def _with(key: str, value: object) -> Callable[[dict[str, Any]], None]:
    def put(bearing: dict[str, Any]) -> None:
        bearing[key] = value

    return put


@pytest.mark.parametrize(
    ("bearing", "text"),
    [
        ({}, "bearing must give way in one direction or more"),
        ({"tilt_z": {"stiffness": 1.0}}, "tilt_z must be across the axis of its joint"),
        ({"tilt_x": {}}, "tilt_x.stiffness must be"),
        ({"tilt_x": {"stiffness": 0.0}}, "tilt_x.stiffness must be"),
        ({"tilt_x": {"stiffness": float("nan")}}, "tilt_x.stiffness must be"),
        ({"tilt_x": {"stiffness": 1.0, "damping": -1.0}}, "tilt_x.damping must be"),
        ({"tilt_x": {"stiffness": 1.0, "reach": 1.0}}, "tilt_x.reach must be known"),
        ({"tilt_w": {"stiffness": 1.0}}, "bearing must give way in one direction or more"),
        ({"tilt_x": {"stiffness": 1.0}, "tilt_w": {}}, "tilt_w must be known"),
        ({"tilt_x": 5.0}, "tilt_x must be a section"),
        (5.0, "bearing must be a section"),
    ],
)
def test_bad_bearings_are_refused(bearing: object, text: str, tmp_path: Path) -> None:
    joints = {"joint_0": {"bearing": bearing}}
    with pytest.raises(Refusal, match=text):
        load_scene(write_scene(tmp_path, arm_urdf(1), joints))


def test_directions_are_across_the_axis_of_the_joint(tmp_path: Path) -> None:
    spring = {"stiffness": 1e4}

    def load(kind: str, axis: str, *names: str) -> Scene:
        urdf = arm_urdf(1, kind, axis)
        joints = {"joint_0": {"bearing": dict.fromkeys(names, spring)}}
        return load_scene(write_scene(tmp_path, urdf, joints))

    assert len(load("continuous", "0 1 0", "tilt_x", "tilt_z", "shift_y").machine_joints) == 4
    assert len(load("prismatic", "1 0 0", "tilt_x", "shift_y").machine_joints) == 3
    for kind, axis, name in (
        ("continuous", "0 1 0", "tilt_y"),
        ("prismatic", "1 0 0", "shift_x"),
        ("continuous", "0.6 0 0.8", "tilt_x"),
    ):
        with pytest.raises(Refusal, match=f"{name} must be across"):
            load(kind, axis, name)


def test_a_body_that_does_not_fill_space_is_refused(tmp_path: Path) -> None:
    """A rod turns about its own length without inertia."""
    xx, yy, _ = INERTIA
    rod = arm_urdf(1).replace(f"ixx='{xx}'", "ixx='0'").replace(f"iyy='{yy}'", "iyy='0.05'")
    joints: dict[str, Any] = {"joint_0": {}}
    load_scene(write_scene(tmp_path, rod, joints))
    joints["joint_0"]["bearing"] = {"tilt_x": {"stiffness": 1.0}}
    with pytest.raises(Refusal, match=r"inertia moved by joint .* in a bearing that gives way"):
        load_scene(write_scene(tmp_path, rod, joints))
