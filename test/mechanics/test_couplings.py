"""Joints that do not go each with a drive: telescopes, palletizers, bevel wrists, any matrix C."""

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from draws import FULL, some, with_slow
from machines import links_of
from scipy.integrate import solve_ivp

from arm_emulator import (
    ExternalWrench,
    Kinematics,
    Plant,
    Refusal,
    Scene,
    load_gains,
    load_scene,
    sensitivities,
)
from arm_emulator.analysis.holding import LinkLoads, find_overloads
from arm_emulator.analysis.sensitivities import list_varied_numbers
from arm_emulator.cli.commands.tune import tune_scene
from arm_emulator.design.new_scene import write_new
from arm_emulator.machine.session.tool_chain import ToolChain
from arm_emulator.motion.model.link_torques import LinkTorques
from arm_emulator.runs.breakpoint import Breakpoint
from arm_emulator_fleet import Fleet
from oracles.any_arm import draw_reachable, move_arm
from oracles.coupled_arms import (
    ARMS,
    BOOM,
    GRAVITY,
    WRIST,
    Lagrange,
    Shares,
    list_shafts,
    make_coupling_matrix,
    write_mimic,
)
from oracles.own_robots import RobotPart, write_serial


def drive(ratio: float) -> dict[str, Any]:
    return {
        "motor": {
            "kind": "torque", "rotor_inertia": 2e-4, "friction": {"viscous": 1e-3},
        },
        "gear": {"ratio": ratio, "stiffness": 4e3, "damping": 6.0},
        "friction": {"viscous": 0.8},
    }  # fmt: skip


def machine(folder: Path, parts: list[RobotPart], shares: Shares, **more: Any) -> Scene:
    (folder / "arm.urdf").write_text(write_serial("arm", parts))
    shafts = list_shafts(parts, shares)
    draw = np.random.default_rng(5)
    drives = {name: drive(0.03) | {"start": float(draw.uniform(-0.2, 0.3))} for name in shafts}
    scene = {
        "name": "arm",
        "urdf": "arm.urdf",
        "tool": "tool0",
        "gravity": list(GRAVITY),
        "supply_voltage": 48.0,
        "couplings": shares,
        "joints": drives,
        "integrator": {"scheme": "rosenbrock", "dt": 1e-4},
        "servo_period": 1e-3,
    }  # fmt: skip
    file = folder / "arm.yaml"
    file.write_text(yaml.safe_dump(scene | more))
    return load_scene(file)


def any_arm(seed: int) -> tuple[list[RobotPart], Shares]:
    """A chain of any joints whose shafts move them by any matrix of full rank."""
    draw = np.random.default_rng(seed)
    L = int(draw.integers(2, 7))
    parts = [
        RobotPart(
            " ".join(map(repr, draw.normal(size=3).tolist())),
            tuple(draw.uniform(-0.4, 0.4, 3).tolist()),
            float(draw.uniform(0.5, 4.0)),
            str(draw.choice(["revolute", "revolute", "prismatic"])),
            (-2.0, 2.0),
        )
        for _ in range(L)
    ]
    names = [f"j{k + 1}" for k in range(L)]
    shafts = sorted(draw.permutation(names)[: int(draw.integers(1, L + 1))].tolist())
    return parts, {name: {shaft: float(draw.normal()) for shaft in shafts} for name in names}


CASES: dict[str, Callable[[], tuple[list[RobotPart], Shares]]] = {
    **{name: (lambda arm=arm: arm) for name, arm in ARMS.items()},
    **{f"any {seed}": (lambda seed=seed: any_arm(seed)) for seed in range(20)},
}


@pytest.mark.parametrize(
    "name",
    with_slow(
        some(sorted(CASES, key=lambda name: name not in ("palletizer", "differential")), 2), 1
    ),
)
def test_the_links_move_as_by_explicit_constraints(name: str, tmp_path: Path) -> None:
    parts, shares = CASES[name]()
    free: dict[str, Any] = {name: {} for name in list_shafts(parts, shares)}
    scene = machine(tmp_path, parts, shares, joints=free)
    assert list(scene.joint_names) == list_shafts(parts, shares)
    C = make_coupling_matrix(parts, shares)
    truth = Lagrange(write_serial("arm", parts), C, np.zeros(len(parts)))
    links, draw = links_of(scene), np.random.default_rng(1)
    loads = LinkLoads(scene)
    for _ in range(20):
        p, v, T = (draw.normal(size=C.shape[1]) * size for size in (1.0, 2.0, 30.0))
        expected = truth.compute_accelerations(p, v, T)
        actual = links.accelerations(p, v, T)
        np.testing.assert_allclose(actual, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())
        M, still = loads.compute_mass_matrix(p), np.zeros_like(v)
        actual = np.linalg.solve(M, T - loads.compute_weight(p))
        expected = truth.compute_accelerations(p, still, T)
        np.testing.assert_allclose(actual, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize("name", some(list(ARMS), 1))
def test_the_machine_moves_as_its_equations(name: str, tmp_path: Path) -> None:
    """Rotors, gears, friction of rotors and shafts, on the right side of the coupling: order 2."""
    parts, shares = ARMS[name]
    scene = machine(tmp_path, parts, shares)
    C = make_coupling_matrix(parts, shares)
    truth = Lagrange(write_serial("arm", parts), C, np.zeros(len(parts)))
    N, Ng, Kg, Dg, Mm, Dl, Dv = C.shape[1], 0.03, 4e3, 6.0, 2e-4, 0.8, 1e-3
    u = 0.2 * np.cos(np.arange(N))
    assert any(abs(entry) not in (0.0, 1.0) or (row != 0.0).sum() > 1 for row in C for entry in row)

    def rates(_: float, x: np.ndarray) -> np.ndarray:
        theta, omega, p, v = x.reshape(4, N)
        T = Kg * (Ng * theta - p) + Dg * (Ng * omega - v)
        alpha = (u - Dv * omega - Ng * T) / Mm
        return np.concatenate([omega, alpha, v, truth.compute_accelerations(p, v, T - Dl * v)])

    end, start = 0.2, scene.start
    x = np.concatenate([start / Ng, np.zeros(N), start, np.zeros(N)])
    solved = solve_ivp(rates, (0.0, end), x, method="DOP853", rtol=1e-12, atol=1e-14)
    expected = solved.y[2 * N : 3 * N, -1]
    errors = []
    for dt in (1e-4, 5e-5):
        at_step = machine(tmp_path, parts, shares, integrator={"scheme": "rosenbrock", "dt": dt})
        plant = Plant(at_step)
        plant.advance(u, round(end / dt))
        errors.append(float(np.abs(plant.state.q - expected).max()))
        np.testing.assert_allclose(Ng * plant.state.theta_m, plant.state.q, atol=0.05)
    distance = float(np.abs(expected - start).max())
    assert distance > 0.02, "it moves"
    assert errors[1] < 1e-6 * distance
    assert 3.2 < errors[0] / errors[1] < 4.8, f"order 2: {errors}"


@pytest.mark.slow
def test_mimic_joints_between_base_and_tool_move_along(tmp_path: Path) -> None:
    """Kinematics, limits, torques and dynamics of a telescope, by its description alone."""
    text = write_mimic(write_serial("arm", BOOM), "j4", "j3", 0.5, 0.02)
    text = write_mimic(text, "j5", "j4", -0.6, 0.1)  # a mimic of a mimic
    (tmp_path / "arm.urdf").write_text(text)
    names = ("j1", "j2", "j3")
    scene = {
        "name": "arm", "urdf": "arm.urdf", "tool": "tool0", "gravity": list(GRAVITY),
        "supply_voltage": 48.0, "joints": {name: {} for name in names},
        "integrator": {"dt": 1e-3}, "servo_period": 1e-3,
    }  # fmt: skip
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(scene))
    loaded = load_scene(tmp_path / "arm.yaml")
    assert loaded.joint_names == names
    C = np.vstack([np.eye(3), [0.0, 0.0, 0.5], [0.0, 0.0, -0.3]])
    q_0 = np.array([0.0, 0.0, 0.0, 0.02, 0.1 - 0.6 * 0.02])
    truth = Lagrange(text, C, q_0)
    frame = truth.model.getFrameId("tool0")
    kinematics = Kinematics(text, names, "tool0", task="pose")
    torques = LinkTorques(text, names, GRAVITY)
    links, draw = links_of(loaded), np.random.default_rng(2)
    for _ in range(10):
        p, v, T = (draw.normal(size=3) * size for size in (0.5, 1.0, 20.0))
        pin.framesForwardKinematics(truth.model, truth.data, C @ p + q_0)
        R, at = kinematics.forward(p)
        np.testing.assert_allclose(at, truth.data.oMf[frame].translation, atol=1e-12)
        np.testing.assert_allclose(R, truth.data.oMf[frame].rotation, atol=1e-12)
        J = pin.computeFrameJacobian(
            truth.model, truth.data, C @ p + q_0, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        np.testing.assert_allclose(kinematics.jacobian(p), J @ C, atol=1e-12)
        a = truth.compute_accelerations(p, v, T)
        np.testing.assert_allclose(links.accelerations(p, v, T), a, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(torques.compute_torques(p, v, a), T, rtol=1e-9, atol=1e-9)
    # 0 <= 0.5 p + 0.02 <= 0.4 and 0 <= 0.088 - 0.3 p <= 0.3, within 0 .. 0.6.
    assert kinematics.lower[2] == pytest.approx(0.0)
    assert kinematics.upper[2] == pytest.approx(0.088 / 0.3)


@pytest.mark.parametrize("seed", range(10))
def test_limits_of_shafts_keep_all_joints_within_theirs(seed: int) -> None:
    """Positions, and speeds; at the corners of the box some joint is at its limit."""
    from arm_emulator.base.urdf.shafts import Shafts

    draw = np.random.default_rng(seed)
    parts, shares = any_arm(seed)
    robot = ET.fromstring(write_serial("arm", parts))
    for joint in robot.findall("joint"):
        for shaft, share in shares.get(joint.get("name", ""), {}).items():
            ET.SubElement(joint, "coupling", joint=shaft, multiplier=repr(share))
    names = list_shafts(parts, shares)
    shafts = Shafts(ET.tostring(robot, encoding="unicode"), names)
    L = len(shafts.joints)
    lower = draw.uniform(-2.0, -0.5, L)
    upper = draw.uniform(0.5, 2.0, L)
    low, high = shafts.bound_positions(lower, upper)
    largest = shafts.bound_rates(upper)
    assert (low <= high).all()
    for corner in draw.choice([0.0, 1.0], (50, len(names))):
        q = shafts.convert_to_joints(low + corner * (high - low))
        assert (q > lower - 1e-9).all() and (q < upper + 1e-9).all()
        assert (np.abs(shafts.convert_rates((2.0 * corner - 1.0) * largest)) < upper + 1e-9).all()


BAD: list[tuple[Shares, str]] = [
    ({"j4": {"nobody": 1.0}}, "must name a joint of the URDF, got 'nobody'"),
    ({"j4": {"j5": 1.0}, "j5": {"j4": 1.0}}, "must follow a joint that moves by itself"),
    ({"j4": {"j3": 0.0}}, ""),
    ({"j3": {"j3": 1.0, "j2": 1.0}, "j2": {"j3": 2.0, "j2": 2.0}}, "independent columns"),
    ({"j9": {"j3": 1.0}}, "must be a joint of the URDF, got j9"),
]


@pytest.mark.parametrize(("shares", "words"), BAD)
def test_couplings_that_move_nothing_are_refused(
    shares: Shares, words: str, tmp_path: Path
) -> None:
    if not words:  # a joint that stands still with its shaft is a fixed one
        machine(tmp_path, BOOM, shares)
        return
    with pytest.raises(Refusal, match=words) as refusal:
        machine(tmp_path, BOOM, shares)
    assert "\n" not in str(refusal.value)


def assert_keeps_energy(plant: Plant) -> None:
    """A machine without losses falls from 0.2 rad or m."""
    N = len(plant.scene.joints)
    plant.reset(np.full(N, 0.2))
    before, moved = plant.energy, []
    for _ in range(20):
        plant.advance(np.zeros(N), 100)
        moved.append(plant.energy - before)
    v, M = plant.state.v, LinkLoads(plant.scene).compute_mass_matrix(plant.state.q)
    assert np.abs(v).max() > 0.3 and np.abs(moved).max() < 1e-6 * 0.5 * v @ M @ v


@pytest.mark.slow
@pytest.mark.parametrize("name", ["telescope", *some([*ARMS][1:], 0)])
def test_wrenches_units_numbers_and_faults_act_on_any_link(name: str, tmp_path: Path) -> None:
    """On links with and without a drive: what a unit measures is what the constraints give."""
    parts, shares = ARMS[name]
    unit = {"link": "tool0", "xyz": [0.1, -0.2, 0.05], "rpy": [0.3, -0.7, 1.1]}
    masses = {"links.l4.mass": 2.5, "links.l5.mass": 0.4}
    scene = machine(
        tmp_path, parts, shares, external_wrench=True, imus={"unit": unit}, varied=list(masses),
        faults=["base_tilts"], joints={shaft: {} for shaft in list_shafts(parts, shares)},
    )  # fmt: skip
    plant, draw = Plant(scene), np.random.default_rng(7)
    assert_keeps_energy(plant)
    assert list(plant.external_wrenches) == [link.link for link in scene.chain.links]
    truth = Lagrange(
        write_serial("arm", parts), make_coupling_matrix(parts, shares), np.zeros(len(parts))
    )
    model = truth.model
    tool = model.frames[model.getFrameId("tool0")]
    pose = pin.SE3(pin.rpy.rpyToMatrix(*unit["rpy"]), np.array(unit["xyz"]))
    frame = model.addFrame(pin.Frame("unit", tool.parentJoint, tool.placement * pose, pin.OP_FRAME))
    data = truth.data = model.createData()
    local, aligned = pin.ReferenceFrame.LOCAL, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    tilt = 0.3
    plant.set_parameter("faults.base_tilts", tilt)
    model.gravity.linear = pin.rpy.rpyToMatrix(-tilt, 0.0, 0.0) @ np.array(GRAVITY)
    for link, mass in masses.items():
        plant.set_parameter(link, mass)
        body = model.inertias[int(link.split(".")[1][1:])]
        body.mass, lever, about = mass, body.mass * body.lever, body.matrix()[3:, 3:]
        body.lever = lever / mass  # a varied mass leaves its moments as they are
        body.inertia = about - mass * pin.skew(body.lever) @ pin.skew(body.lever).T
    for _ in range(10):
        p, v, f, n = (draw.normal(size=k) for k in (len(scene.joints), len(scene.joints), 3, 3))
        plant.reset(p, v)
        tau = np.zeros(len(parts))
        pushed = {}
        for link in ("l3", "l5"):
            force, moment, point = 40.0 * f, 20.0 * n, draw.normal(size=3)
            wrench = ExternalWrench(force, moment, point, axes="world")
            plant.set_external_wrench(link, wrench)
            pushed[link] = wrench
        plant.exchange(np.zeros(len(p)))
        x, q = plant.state, truth.C @ plant.state.q
        pin.framesForwardKinematics(model, data, q)
        for link, wrench in pushed.items():
            J = pin.computeFrameJacobian(model, data, q, model.getFrameId(link), aligned)
            R = pin.updateFramePlacement(model, data, model.getFrameId(link)).rotation
            moment = wrench.moment + np.cross(R @ wrench.point, wrench.force)
            tau += J.T @ np.concatenate([wrench.force, moment])
        a = truth.compute_accelerations(x.q, x.v, np.zeros(len(p)), tau)
        pin.forwardKinematics(model, data, q, truth.C @ x.v, truth.C @ a)
        feels = pin.getFrameClassicalAcceleration(model, data, frame, local).linear
        R = pin.updateFramePlacement(model, data, frame).rotation
        feels = feels - R.T @ model.gravity.linear
        rotations = pin.getFrameVelocity(model, data, frame, local).angular
        scale = 1.0 + float(np.abs(feels).max())
        actual = plant.measured
        np.testing.assert_allclose(actual.specific_force[0], feels, rtol=0.0, atol=1e-9 * scale)
        np.testing.assert_allclose(actual.angular_rate[0], rotations, rtol=0.0, atol=1e-11 * scale)
    pin.framesForwardKinematics(model, data, q)
    there = data.oMf[model.getFrameId("tool0")].translation
    np.testing.assert_allclose(
        ToolChain(scene).compute_positions(x.q[:, None])[:, 0], there, atol=1e-12
    )
    for axis, at_axis in zip("xyz", there, strict=True):
        for off in (-1e-9, 1e-9):
            stop = Breakpoint(plant, f"tool.{axis} > {float(at_axis + off)!r}")
            assert stop.struct.held == (off < 0.0)


@pytest.mark.slow
def test_new_takes_a_telescope_and_the_tool_goes_where_it_is_sent(tmp_path: Path) -> None:
    """By its description: one drive for all slides; the whole machine arrives."""
    text = write_mimic(write_serial("arm", BOOM), "j4", "j3", 0.6, 0.0)
    text = write_mimic(text, "j5", "j3", 0.4, 0.0)
    file = tmp_path / "arm.urdf"
    file.write_text(text)
    written = write_new(file, tmp_path / "new")
    assert written.choice.joints == ("j1", "j2", "j3") and not written.choice.locked
    assert written.choice.tool == "tool0"
    scene, gains = load_scene(written.file), load_gains(written.file)
    kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    pair = draw_reachable(kinematics, 0.2, np.random.default_rng(1))
    assert pair is not None
    outcome = move_arm(scene, gains, "50 mm", *pair)
    assert not outcome.words and outcome.peak_speed <= 1.0 and not outcome.has_overshot, outcome


@pytest.mark.skipif(not FULL, reason="compiles a machine and its lanes: make test-in-full")
def test_an_arm_with_a_differential_goes_where_it_is_sent(tmp_path: Path) -> None:
    """Servo and motion control take shafts; the true tool, by the joints, arrives."""
    file = tmp_path / "arm.urdf"
    # Both motors of the differential carry what its first axis takes.
    efforts = (60.0, 120.0, 30.0, 20.0, 20.0)
    parts = [replace(part, effort=value) for part, value in zip(WRIST, efforts, strict=True)]
    file.write_text(write_serial("arm", parts))
    written = write_new(file, tmp_path / "new")
    _, shares = ARMS["differential"]
    scene = yaml.safe_load(written.file.read_text()) | {"couplings": shares}
    written.file.write_text(yaml.safe_dump(scene))
    with pytest.raises(Refusal, match=r"j4\.end_stops\.at must be absent"):
        load_scene(written.file)  # the URDF's limits are those of joints, not of these shafts
    for name in shares:
        del scene["joints"][name]["end_stops"]
    written.file.write_text(yaml.safe_dump(scene))
    assert tune_scene(str(written.file), write=True) == 0
    scene, gains = load_scene(written.file), load_gains(written.file)
    kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    truth = Lagrange(write_serial("arm", WRIST), make_coupling_matrix(WRIST, shares), np.zeros(5))
    frame, p = truth.model.getFrameId("tool0"), np.array([0.3, -0.2, 0.5, 0.4, -0.7])
    pin.framesForwardKinematics(truth.model, truth.data, truth.C @ p)
    expected = truth.data.oMf[frame].translation
    np.testing.assert_allclose(kinematics.forward(p)[1], expected, atol=1e-12)
    assert not find_overloads(scene)
    pair = draw_reachable(kinematics, 0.1, np.random.default_rng(1))
    assert pair is not None
    value = move_arm(scene, gains, "50 mm", *pair)
    assert not value.words and value.peak_speed <= 1.0 and not value.has_overshot, value


@pytest.mark.skipif(not FULL, reason="fleets are compiled once more for it: make test-in-full")
@pytest.mark.parametrize("name", ARMS)
def test_lanes_of_a_fleet_move_as_a_single_machine(name: str, tmp_path: Path) -> None:
    scene = machine(tmp_path, *ARMS[name], external_wrench=True, varied=["links.l4.mass"])
    fleet, plant = Fleet(scene, 9), Plant(scene)
    push = ExternalWrench((20.0, -30.0, 10.0), (1.0, 2.0, -3.0), (0.1, 0.0, 0.2), axes="world")
    for machine_or_fleet in (fleet, plant):
        machine_or_fleet.set_external_wrench("l5", push)
        machine_or_fleet.set_parameter("links.l4.mass", 3.3)
    u = 0.3 * np.cos(np.arange(len(scene.joints)))
    fleet.run(np.tile(u, (1, 9, 1)), 200)
    plant.advance(u, 200)
    np.testing.assert_array_equal(fleet.state.q, np.tile(plant.state.q, (9, 1)))


@pytest.mark.skipif(not FULL, reason="dual numbers are compiled for it: make test-in-full")
def test_derivatives_are_those_of_the_motion(tmp_path: Path) -> None:
    """By the mass of a link without a drive and the stiffness of its shaft; central differences."""
    names = ["joints.j3.gear.stiffness", "links.l5.mass"]
    scene = machine(tmp_path, *ARMS["telescope"], varied=names)
    rows = np.random.default_rng(3).normal(0.0, 0.4, (10, len(scene.joints)))
    of, values = sensitivities(scene, rows, names), list_varied_numbers(scene)
    for i, name in enumerate(names):
        value, ends = values[name].value, []
        for share in (1e-4, -1e-4):
            plant = Plant(scene)
            plant.set_parameter(name, value * (1.0 + share))
            ends.append(plant.run(rows, scene.steps_per_period)[-1])
        expected = (ends[0] - ends[1]) / (2e-4 * value)
        np.testing.assert_allclose(of.by["q"][-1][:, i], expected, rtol=1e-5, atol=1e-12)
