"""Bearings that give way: closed forms, modes by Pinocchio and SciPy, energy, what doors show."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from machines import write_scene
from network import assert_same_bits, network, offline_states
from scipy.optimize import brentq

from arm_emulator import (
    ExternalWrench,
    Plant,
    Pose,
    Refusal,
    Scene,
    linearise,
    load_scene,
    sensitivities,
)
from arm_emulator.base.io.config_files import find_config
from arm_emulator.design.tuned import compute_falls
from arm_emulator.machine.plant.scene_unit import write_scene_unit
from arm_emulator.machine.scene.urdf_file import find_example_robot_data
from arm_emulator.machine.session.tool_chain import ToolChain
from arm_emulator.runs.offline import load_offline_run
from arm_emulator_msgs.msg import MotorState

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
    folder, varied = tmp_path_factory.mktemp("arm"), ["joints.*.bearing.*"]
    return make_scene(folder, [SPRINGS, UPPER], varied=varied)


def settle(plant: Plant) -> None:
    plant.advance(np.zeros(len(plant.scene.joints)), 200_000)


def list_deflections(plant: Plant) -> dict[str, float]:
    measured = plant.measured
    return {name: float(getattr(measured, f"bearing_{name}")[0]) for name in SPRINGS}


@pytest.mark.slow
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
    # LAPACK solves both systems, of condition 1e6; the slopes of the core are exact.
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
    # The scheme is of second order, in steps of 0.1 ms; the modes are below 300 Hz.
    assert lost == pytest.approx(flow.dissipated.sum() - flow.supplied.sum(), rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("events", ["step", "located"])
def test_derivatives_are_those_of_differences(events: str, arm: Scene) -> None:
    """Central differences over 2e-4 of a number lack 1e-8 of its third derivative."""
    name = "joints.joint_0.bearing.tilt_x.stiffness"
    scene = replace(arm, integrator=replace(arm.integrator, events=events))
    commands = np.random.default_rng(1).uniform(-4.0, 4.0, (60, 2))
    motion = sensitivities(scene, commands, [name, "start.q.joint_1"], steps=20)
    stiffness = SPRINGS["tilt_x"]["stiffness"]

    def run(value: float, start: float) -> np.ndarray:
        plant = Plant(scene)
        plant.set_parameter(name, value)
        plant.reset([0.0, start])
        return plant.run(commands, 20)

    h, d = 1e-4 * stiffness, 1e-4
    expected = [
        (run(stiffness + h, 0.0) - run(stiffness - h, 0.0)) / (2.0 * h),
        (run(stiffness, d) - run(stiffness, -d)) / (2.0 * d),
    ]
    for k, slopes in enumerate(expected):
        size = np.abs(slopes).max()
        assert motion.by["q"][..., k] == pytest.approx(slopes, abs=1e-5 * size)
    assert np.abs(expected[0][:, 0]).max() > 0.0, "the bearing matters"


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


def write_ur5(folder: Path) -> Path:
    """Write a UR5 with large joints in bearings, and the gains of the one without."""
    file = find_config("ur5", ".yaml")
    data = yaml.safe_load(file.read_text(encoding="utf-8"))
    tilt = {"stiffness": 4e4, "damping": 20.0}
    for name, axes in {"shoulder_pan": "xy", "shoulder_lift": "xz", "elbow": "xz"}.items():
        data["joints"][f"{name}_joint"]["bearing"] = {f"tilt_{axis}": tilt for axis in axes}
    data |= {kind: str(find_config("ur5", ".yaml", kind)) for kind in ("servo", "motion")}
    written = folder / "ur5.yaml"
    written.write_text(yaml.safe_dump(data))
    return written


@pytest.mark.slow
@pytest.mark.skipif(
    find_example_robot_data() is None, reason="needs the package example-robot-data"
)
def test_three_nodes_move_a_robot_in_bearings_as_a_run_without_a_network(tmp_path: Path) -> None:
    """Servo and motion controller know nothing of them, and messages show the deflections."""
    file, ticks, at = write_ur5(tmp_path), 300, 0.1
    run = load_offline_run(str(file))
    scene = run.session.scene
    R_WT, p_WT = run.controller.kinematics.forward(scene.start)
    orientation = Pose(p_WT, R_WT).quaternion()
    target = Pose.from_quaternion(p_WT + np.array([0.0, 0.01, 0.0]), orientation)
    run.instructor.add(round(at * 1e9), target)
    expected = offline_states(run, ticks)
    with network(tmp_path, scene=str(file)) as (user, _):
        user.joint_names = list(scene.joint_names)
        received: list[MotorState] = []
        user.node.create_subscription(MotorState, "motor_states", received.append, 10)
        user.await_start()
        x, y, z, w = map(float, target.quaternion())
        user.send_tool_target(tuple(map(float, target.p_WT)), at, (x, y, z, w))
        user.wait("the target", lambda: user.value("motion_controller", "tool targets") == "1")
        assert user.call("emulator/pause", False).success
        user.wait("the run", lambda: user.tick >= ticks and bool(received))
        assert_same_bits(user.motor_states(), expected, ticks)
    assert list(received[-1].joint_names) == list(scene.joint_names)
    names = [f"bearing_tilt_{axis}" for axis in "xyz"]
    assert list(received[-1].reading_names) == names
    readings = np.array(received[-1].readings).reshape(3, 6)
    assert (readings[:, 3:] == 0.0).all(), "wrists are rigid"
    measured = run.session.measured
    assert np.abs(measured.bearing_tilt_x[:3]).max() > 1e-5, "the arm's weight bends its bearings"
    # The tool of the machine is off by that, behind joints that are at their targets.
    off = run.true_tool[1] - run.controller.kinematics.forward(run.session.state.q)[1]
    assert 1e-5 < np.linalg.norm(off) < 1e-2


def test_tuning_and_coupled_joints_refuse_bearings(arm: Scene, tmp_path: Path) -> None:
    text = r"joints\.joint_0\.bearing\.shift_x must be absent for tuning"
    with pytest.raises(Refusal, match=text):
        compute_falls(arm)
    with pytest.raises(Refusal, match="must be absent for the position of the tool"):
        ToolChain(arm)
    urdf = arm_urdf(2).replace("</robot>", "") + (
        "<link name='hand'><inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1' ixy='0' "
        "ixz='0' iyz='0'/></inertial></link><joint name='finger' type='continuous'>"
        "<parent link='link_1'/><child link='hand'/><axis xyz='0 0 1'/><mimic joint='joint_1'/>"
        "</joint></robot>"
    )
    joints: dict[str, Any] = {"joint_0": {"bearing": SPRINGS}, "joint_1": {}}
    with pytest.raises(Refusal, match=r"shift_x must be absent where joints are coupled"):
        load_scene(write_scene(tmp_path, urdf, joints))


def test_a_scene_without_bearings_has_no_word_of_them(tmp_path: Path) -> None:
    """So its library is the same, and its bits are."""
    scene = load_scene(write_scene(tmp_path, arm_urdf(1), {"joint_0": {"motor": MOTOR}}))
    text = write_scene_unit(scene)
    assert "drive_of" not in text and "deflection" not in text
    assert scene.true_urdf == scene.urdf
    assert list(scene.machine_joints.values()) == list(scene.joints)
