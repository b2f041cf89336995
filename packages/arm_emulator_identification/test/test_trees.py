"""Trees of links: the core against Pinocchio, and what rests on it for several branches."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import FULL, some
from machines import (
    GRAVITY,
    MOTOR,
    Oracle,
    list_moving_joints,
    random_tree,
    write_random_tree,
    write_scene,
)

from arm_emulator.analysis.holding import LinkLoads
from arm_emulator.analysis.sensitivities import list_varied_numbers, sensitivities
from arm_emulator.machine.plant.external_wrench import ExternalWrench
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.machine.schemes.known import KNOWN
from arm_emulator.machine.session.tool_chain import ToolChain
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.motion.model.pose import Pose
from arm_emulator.motion.planner.target_planner import TargetPlanner
from arm_emulator.runs.breakpoint import Breakpoint
from arm_emulator_fleet.fleet import Fleet
from arm_emulator_identification.inertia import list_dynamic
from arm_emulator_identification.link_regressor import LinkRegressor
from oracles.reference import solve_positions

STATES = 200
# Both sides lose about cond(M) units of the last place, and cond(M) < 1e5 here.
TOLERANCE = 1e-10

# Seed and joints: chosen so that all fork, five on the base as well as farther out. 14 and 30 lie
# beyond limits of unrolling.
TREES = [(1, 5), (2, 12), (3, 3), (4, 7), (5, 14), (6, 9), (7, 26)]


def relative(actual: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(actual - expected) / np.linalg.norm(expected))


@pytest.mark.parametrize(("seed", "joints"), some(TREES, 1))
def test_random_trees_equal_pinocchio(tmp_path: Path, seed: int, joints: int) -> None:
    """M, nle, accelerations and energy; revolute and prismatic joints about any axis."""
    scene = random_tree(tmp_path, seed, joints, gravity=GRAVITY)
    assert scene.chain.is_branched, "the draw is a chain"
    plant, oracle, rng = Plant(scene), Oracle(scene), np.random.default_rng(seed)
    q, v, tau = rng.normal(size=(3, STATES, joints)) * np.array([2.0, 3.0, 30.0])[:, None, None]
    M, nle = plant.links.mass_matrix(q), plant.links.nle(q, v)
    a = plant.links.accelerations(q, v, tau)
    for k in range(STATES):
        assert relative(M[k], oracle.mass_matrix(q[k])) < TOLERANCE, "mass matrix"
        assert relative(nle[k], oracle.nle(q[k], v[k])) < TOLERANCE, "nonlinear effects"
        assert relative(a[k], oracle.aba(q[k], v[k], tau[k])) < TOLERANCE, "accelerations"
    apart = np.array(
        [[i not in scene.chain.find_path(j) and j not in scene.chain.find_path(i)
          for j in range(joints)] for i in range(joints)]
    )  # fmt: skip
    assert (M[:, apart] == 0.0).all(), "joints of different branches do not feel each other"
    plant.reset(q[0], v[0])
    # The same few hundred operations in another order.
    assert plant.energy == pytest.approx(oracle.energy(q[0], v[0]), rel=1e-12), "energy [J]"
    scene = dataclasses.replace(scene, tool=scene.chain.links[-1].link)
    plant = Plant(scene)
    plant.reset(q[0])
    for axis, p in zip("xyz", oracle.place(q[0], scene.tool), strict=True):
        for off in (-1e-9, 1e-9):
            stop = Breakpoint(plant, f"tool.{axis} > {float(p + off)!r}")
            assert stop.struct.held == (off < 0.0), "a breakpoint's tool is where the tool is"
            stop.close()


PERIOD, ROWS, ARMS = 2e-3, 10, 9


def driven_tree(folder: Path) -> Path:
    """Two branches on a link that slides, one of them of two joints; elastic and rigid gears."""
    urdf = write_random_tree(np.random.default_rng(1), 4)
    names = list_moving_joints(urdf)
    elastic = {"ratio": 0.05, "stiffness": 3e3, "damping": 3.0}
    joints: dict[str, Any] = {
        name: {"motor": MOTOR, "gear": elastic, "friction": {"viscous": 0.5}} for name in names
    }
    joints[names[2]]["gear"] = {"ratio": 0.05}
    keys = {"integrator": {"scheme": "rosenbrock", "dt": 1e-4}, "servo_period": PERIOD}
    return write_scene(
        folder,
        urdf,
        joints,
        gravity=GRAVITY,
        external_wrench=True,
        tool=f"{names[-1]}_link",
        **keys,
    )


def commands() -> np.ndarray:
    return np.random.default_rng(5).normal(0.0, 10.0, (ROWS, 4))


@pytest.mark.slow
@pytest.mark.parametrize("scheme", some(["rosenbrock", "paper", "implicit", "extrapolated"], 1))
def test_a_driven_tree_keeps_the_order_of_its_scheme(tmp_path: Path, scheme: str) -> None:
    file, rows = driven_tree(tmp_path), commands()
    truth = solve_positions(load_scene(file), rows, PERIOD)
    errors = []
    for dt in (1e-4, 5e-5):
        plant = Plant(load_scene(file, {"integrator.scheme": scheme, "integrator.dt": dt}))
        errors.append(np.abs(plant.run(rows, round(PERIOD / dt)) - truth).max())
    order = KNOWN[scheme].order
    # The next term of the error's expansion is smaller by the step, times the fastest rate.
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.06), "order"
    assert errors[1] < {1: 1e-4, 2: 1e-7}[order], "error [rad or m]"


def test_a_wrench_acts_on_the_path_to_its_link_alone(tmp_path: Path) -> None:
    """J^T w of Pinocchio, on the link of each joint."""
    scene = load_scene(driven_tree(tmp_path))
    plant, oracle, rng = Plant(scene), Oracle(scene), np.random.default_rng(2)
    for j, joint in enumerate(scene.chain.links):
        q, v = rng.normal(size=(2, 4))
        force, moment, point = rng.normal(size=(3, 3))
        wrench = ExternalWrench(force, moment, point, axes="world")
        free = plant.links.nle(q, v)
        plant.set_external_wrench(joint.link, wrench)
        actual = free - plant.links.nle(q, v)
        plant.set_external_wrench(joint.link, ExternalWrench())
        J, R = oracle.jacobian(q, joint.link)
        expected = J.T @ np.concatenate([force, moment + np.cross(R @ point, force)])
        assert actual == pytest.approx(expected, abs=1e-12), "J^T w"
        beside = [k for k in range(4) if k not in scene.chain.find_path(j)]
        assert (expected[beside] == 0.0).all() and np.abs(actual[beside]).max(initial=0.0) < 1e-13


@pytest.mark.skipif(not FULL, reason="lanes are compiled once more for it: make test-in-full")
def test_trees_in_lanes_move_as_single_ones(tmp_path: Path) -> None:
    scene, rows = load_scene(driven_tree(tmp_path)), commands()
    shares = np.linspace(0.5, 1.5, ARMS)
    fleet = Fleet(scene, ARMS)
    fleet.run(rows[:, np.newaxis] * shares[:, np.newaxis], scene.steps_per_period)
    for k, share in enumerate(shares):
        q = Plant(scene).run(share * rows, scene.steps_per_period)[-1]
        assert np.array_equal(fleet.state.q[k], q), f"arm {k}"


@pytest.mark.skipif(not FULL, reason="dual numbers are compiled once more: make test-in-full")
def test_derivatives_of_a_tree_are_those_of_its_motion(tmp_path: Path) -> None:
    """By a stiffness at the root and a mass at a tip, against central differences."""
    file, rows = driven_tree(tmp_path), commands()
    scene = load_scene(file)
    names = [f"joints.{scene.joint_names[0]}.gear.stiffness",
             f"links.{scene.chain.links[-1].link}.mass"]  # fmt: skip
    of = sensitivities(scene, rows, names)
    for i, name in enumerate(names):
        value, varied = list_varied_numbers(scene)[name].value, load_scene(file, {"varied": [name]})
        ends = []
        for share in (1e-4, -1e-4):
            fleet = Fleet(varied, 1, varied={name: np.array([value * (1.0 + share)])})
            fleet.run(rows[:, np.newaxis], scene.steps_per_period)
            ends.append(fleet.state.q[0])
        expected = (ends[0] - ends[1]) / (2e-4 * value)
        assert of.by["q"][-1][:, i] == pytest.approx(expected, rel=1e-6), name


@pytest.mark.parametrize("seed", some(range(8), 2))
def test_the_tool_moves_and_all_beside_it_holds(seed: int) -> None:
    """A tool target moves the joints on its way; what moved beside it comes to rest and stays."""
    rng = np.random.default_rng([seed, 3])
    arm = None
    while arm is None or not 4 <= arm.to_tool.sum() < 9:  # one draw of three
        urdf = write_random_tree(rng, 9)
        names = tuple(list_moving_joints(urdf))
        arms = (Kinematics(urdf, names, f"{name}_link", task="position") for name in names)
        arm = max(arms, key=lambda candidate: int(candidate.to_tool.sum()))
    q = rng.uniform(-1.0, 1.0, 9)
    J = arm.jacobian(q)
    assert (J[:, ~arm.to_tool] == 0.0).all()
    law = TargetPlanner(arm, MotionConfig(tool=arm.tool, period=0.01))
    v = np.where(arm.to_tool, 0.0, rng.uniform(-0.2, 0.2, 9))
    law.begin(q, v)
    stop = law.motion.evaluate_at(law.motion.duration).q
    travel = rng.uniform(-0.3, 0.3, 9)
    R_WT, p_WT = arm.forward(q + np.where(arm.to_tool, travel, 0.0))
    target = Pose(p_WT, R_WT)
    rows = [law.update(law.coming.q, target).q for _ in range(1500)]
    assert law.is_resting, law.notices
    end = rows[-1]
    assert np.linalg.norm(arm.tool_error(end, target)) < 1e-6, "the tool is at its target"
    assert end[~arm.to_tool] == pytest.approx(stop[~arm.to_tool], abs=1e-9), "where they stop"
    # Another target from rest leaves them exactly.
    again = Pose(*arm.forward(q)[::-1])
    rows = [law.update(law.coming.q, again).q for _ in range(1500)]
    assert (np.array(rows)[:, ~arm.to_tool] == end[~arm.to_tool]).all()


@pytest.mark.parametrize("seed", range(4))
def test_loads_regressors_and_places_of_a_tree_are_those_of_pinocchio(
    tmp_path: Path, seed: int
) -> None:
    """Python computes them in the order of joints of the scene."""
    scene = random_tree(tmp_path, seed, 8, gravity=GRAVITY)
    oracle, rng = Oracle(scene), np.random.default_rng(seed)
    loads, regressor = LinkLoads(scene), LinkRegressor(scene)
    phi = np.concatenate([list_dynamic(joint.body) for joint in scene.chain.links])
    q, v, a = rng.normal(size=(3, 5, 8))
    tau = regressor(q, v, a) @ phi
    still = np.zeros(8)
    for k in range(5):
        M, nle = oracle.mass_matrix(q[k]), oracle.nle(q[k], v[k])
        assert relative(loads.compute_mass_matrix(q[k]), M) < TOLERANCE, "mass matrix"
        assert relative(loads.compute_weight(q[k]), oracle.nle(q[k], still)) < TOLERANCE, "weight"
        assert relative(tau[k], M @ a[k] + nle) < TOLERANCE, "torques"
    for link in scene.chain.carried:
        tool = dataclasses.replace(scene, tool=link)
        p = ToolChain(tool).compute_positions(q.T)
        expected = [oracle.place(position, link) for position in q]
        assert p.T == pytest.approx(np.array(expected), abs=1e-12), f"place of {link} [m]"
