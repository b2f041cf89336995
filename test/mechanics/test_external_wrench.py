"""Forces and moments on links, and loads that change while the arm moves."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from draws import FULL, some
from machines import GRAVITY, MOTOR, SENSED, list_moving_joints, write_random_chain, write_scene
from scipy.integrate import solve_ivp
from test_fleet_step import LOCATED

from arm_emulator import (
    Diverged,
    ExternalWrench,
    Plant,
    PlantState,
    Refusal,
    Scene,
    load_scene,
)
from arm_emulator.base.arrays import Array
from arm_emulator.machine.plant.external_wrench import AXES
from arm_emulator.machine.plant.scene_unit import write_scene_unit
from arm_emulator_fleet import Fleet
from oracles.reference import ROWS, ReferenceMachine

PERIOD = 1e-2  # s, over which a wrench is held
MASS = 1.5  # kg
PAYLOAD = {"mass": MASS, "com": [0.1, 0.0, 0.05]}


def driven_arm(folder: Path, scheme: str = "extrapolated", **keys: Any) -> Path:
    """Three joints, elastic, rigid (one that slides) and without a motor, with a payload."""
    urdf = write_random_chain(np.random.default_rng(0), 3)
    names = list_moving_joints(urdf)
    joints = {
        names[0]: {"motor": MOTOR, "gear": {"ratio": 0.02, "stiffness": 2e3, "damping": 4.0}},
        names[1]: {"motor": MOTOR, "gear": {"ratio": 0.03}},
        names[2]: {"friction": {"viscous": 0.1}},
    }
    scene = {
        "tool": f"{names[2]}_link",
        "gravity": GRAVITY,
        "payload": PAYLOAD,
        "servo_period": PERIOD,
        "integrator": {"scheme": scheme, "dt": PERIOD / 20},
        "varied": ["payload.mass"],
        "external_wrench": True,
        "energy_flow": True,
    }
    return write_scene(folder, urdf, joints, **{**scene, **keys})


def with_steps(file: Path, steps: int) -> Plant:
    return Plant(load_scene(file, {"integrator.dt": PERIOD / steps}))


def sample_wrench(rng: np.random.Generator, size: float) -> ExternalWrench:
    """A wrench of about `size` [N, N m] at any point of a link, in any axes."""
    force, moment = rng.normal(0.0, size, (2, 3)).tolist()
    return ExternalWrench(force, moment, rng.normal(0.0, 0.3, 3).tolist(), str(rng.choice(AXES)))


def sample_wrenches(
    rng: np.random.Generator, scene: Scene, size: float
) -> dict[str, ExternalWrench]:
    """One for what each joint moves: its link, or a frame that is fixed to it."""
    links = [str(rng.choice(list(joint.links))) for joint in scene.chain.joints]
    return {link: sample_wrench(rng, size) for link in links}


def push(plant: Plant, wrenches: dict[str, ExternalWrench]) -> None:
    for link, wrench in wrenches.items():
        plant.set_external_wrench(link, wrench)


class PushedMachine(ReferenceMachine):
    """The machine in plain NumPy and Pinocchio, under wrenches."""

    def __init__(self, scene: Scene, mass: float = MASS) -> None:
        super().__init__(scene, {**PAYLOAD, "mass": mass})
        self.wrenches: dict[str, ExternalWrench] = {}

    def torques(self, q: Array) -> Array:
        tau = np.zeros(self.N)
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        for link, wrench in self.wrenches.items():
            frame = self.model.getFrameId(link)
            R = self.data.oMf[frame].rotation
            J = pin.getFrameJacobian(self.model, self.data, frame, pin.LOCAL_WORLD_ALIGNED)
            turn = R if wrench.axes == "link" else np.eye(3)
            f, n = turn @ wrench.force, turn @ wrench.moment
            tau += J.T @ np.concatenate([f, n + np.cross(R @ wrench.point, f)])
        return tau

    def compute_rates(self, t: float, flat: Array, V: Array) -> Array:
        dx = super().compute_rates(t, flat, V).reshape(ROWS, self.N)
        q = flat.reshape(ROWS, self.N)[3]
        tau = self.torques(q)
        M = pin.crba(self.model, self.data, q)
        dx[4] += np.linalg.solve(np.triu(M) + np.triu(M, 1).T, tau)
        return dx.ravel()

    def after(self, x: Array, V: Array) -> Array:
        end = solve_ivp(
            self.compute_rates,
            (0.0, PERIOD),
            x.ravel(),
            "DOP853",
            rtol=1e-12,
            atol=1e-13,
            args=(V,),
        )
        out: Array = end.y[:, -1].reshape(x.shape)
        return out


def test_links_accelerate_as_in_pinocchio(tmp_path: Path) -> None:
    """M a + nle = tau + J^T w, on links and frames that are fixed to them, in either axes."""
    rng = np.random.default_rng(1)
    scene = load_scene(driven_arm(tmp_path))
    assert any(len(joint.links) > 1 for joint in scene.chain.joints), "frames fixed to links"
    plant, machine = Plant(scene), PushedMachine(scene)
    machine.model.armature = np.zeros(3)
    for _ in range(100):
        machine.wrenches = sample_wrenches(rng, scene, 20.0)
        push(plant, machine.wrenches)
        q, v, tau = rng.normal(0.0, 1.0, (3, 3))
        a = plant.links.accelerations(q, v, tau)
        expected = pin.aba(machine.model, machine.data, q, v, tau + machine.torques(q))
        np.testing.assert_allclose(a, expected, rtol=1e-9, atol=1e-8, err_msg="accelerations")
    plant.reset()
    assert set(plant.external_wrenches.values()) == {ExternalWrench()}, "after a reset"
    a = plant.links.accelerations(q, v, tau)
    expected = pin.aba(machine.model, machine.data, q, v, tau)
    np.testing.assert_allclose(a, expected, rtol=1e-9, atol=1e-8, err_msg="after a reset")


@pytest.mark.slow
@pytest.mark.parametrize("scheme", some(["extrapolated", "rosenbrock"], 1))
def test_pushes_and_loads_that_change_keep_the_order(tmp_path: Path, scheme: str) -> None:
    """Each period others: a jump of the load is no motion of the links."""
    rng = np.random.default_rng(2)
    file, rows = driven_arm(tmp_path, scheme), 6
    scene = load_scene(file)
    voltages = rng.uniform(-20.0, 20.0, (rows, 3))
    pushes = [sample_wrenches(rng, scene, 20.0) for _ in range(rows)]
    masses = rng.uniform(0.5, 3.0, rows).tolist()
    x, truth = PushedMachine(scene).make_rest_state(scene.start, None), []
    for row, wrenches, mass in zip(voltages, pushes, masses, strict=True):
        machine = PushedMachine(load_scene(file, {"payload.mass": mass}), mass)
        machine.wrenches = wrenches
        x = machine.after(x, row)
        truth.append(x)
    errors = []
    for steps in (20, 40, 80, 160):
        plant, off = with_steps(file, steps), 0.0
        for row, wrenches, mass, there in zip(voltages, pushes, masses, truth, strict=True):
            push(plant, wrenches)
            plant.set_parameter("payload.mass", mass)
            plant.advance(row, steps)
            off = max(
                off, float(np.abs(np.array([plant.state.q, plant.state.v]) - there[3:5]).max())
            )
        errors.append(off)
    assert np.log2(np.array(errors[:-1]) / errors[1:])[-2:] == pytest.approx(2.0, abs=0.15), errors


@pytest.mark.parametrize("seed", range(2))
def test_work_of_wrenches_closes_the_energy_balance(tmp_path: Path, seed: int) -> None:
    """Energy that comes is what is given less what is dissipated, but for a part of order h^2."""
    rng = np.random.default_rng([seed, 3])
    file = driven_arm(tmp_path)
    voltages = rng.uniform(-5.0, 5.0, (6, 3))
    pushes = [sample_wrenches(rng, load_scene(file), 20.0) for _ in voltages]
    left, inputs = [], 0.0
    for steps in (20, 40, 80, 160):
        plant, flow, exchanged = with_steps(file, steps), 0.0, 0.0
        before = plant.energy
        for row, wrenches in zip(voltages, pushes, strict=True):
            push(plant, wrenches)
            metered = plant.advance_metered(row, steps)
            flow += float(metered.supplied.sum() - metered.dissipated.sum())
            exchanged += float(np.abs(metered.supplied).sum() + metered.dissipated.sum())
            inputs += abs(metered.supplied[2])  # of the joint without a motor
        left.append(abs(plant.energy - before - flow) / exchanged)
    assert inputs > 0.01, "the wrenches do work"
    # The order is at least 2; by chance a coefficient may be small.
    assert left[-1] < left[0] / 4.0**3 * 1.6, left
    assert left[-1] < 1e-5, left


# Scheme and threads, and what two threads exchange.
METHODS = [("extrapolated", 1, "predict"), ("extrapolated", 2, "predict"), ("paper", 2, "lag")]


@pytest.mark.parametrize(("scheme", "threads", "exchange"), some(METHODS, 0))
def test_weights_of_all_bodies_are_gravity(
    tmp_path: Path, scheme: str, threads: int, exchange: str
) -> None:
    """A force m g at each centre of mass, with the world's axes, moves the arm as gravity does."""
    file = driven_arm(tmp_path, threads=threads)
    integrator = {"scheme": scheme, "dt": PERIOD / 50, "exchange": exchange}
    falls = load_scene(file, {"integrator": integrator})
    pushed = load_scene(file, {"integrator": integrator, "gravity": None})
    first, second = Plant(falls), Plant(pushed)
    for joint in pushed.chain.joints:
        body = joint.body
        if joint is pushed.chain.joints[-1]:  # the payload's mass is varied
            assert pushed.load is not None
            body = pushed.load.bare + pushed.load.per_kg.scale_mass(MASS)
        com = joint.axes.T @ body.moment / body.mass
        weight = ExternalWrench(body.mass * np.array(GRAVITY), point=com, axes="world")
        second.set_external_wrench(joint.link, weight)
    voltages = np.random.default_rng(5).uniform(-20.0, 20.0, (20, 3))
    moved = first.run(voltages, 50), second.run(voltages, 50)
    # Only rounding differs.
    np.testing.assert_allclose(*moved, rtol=1e-9, atol=1e-9, err_msg="q")
    np.testing.assert_allclose(first.state.v, second.state.v, rtol=1e-8, atol=1e-8, err_msg="v")
    assert np.ptp(moved[0], axis=0).min() > 0.01, "the arm has moved"


def test_hard_pushes_of_an_elastic_arm_are_no_divergence(tmp_path: Path) -> None:
    """The energy of a push is permitted, at any step and any swing."""
    rng = np.random.default_rng(7)
    file = driven_arm(tmp_path)
    for case in range(30):
        plant = with_steps(file, int(rng.choice([5, 10, 20])))
        steps = plant.scene.steps_per_period
        try:
            for _ in range(40):
                if rng.random() < 0.3:
                    push(plant, sample_wrenches(rng, plant.scene, float(10 ** rng.uniform(-1, 2))))
                # The elastic joint swings, the others are held back.
                plant.advance([0.0, 0.0, 0.0], steps)
        except Diverged as fault:
            pytest.fail(f"case {case}: {fault}")


@pytest.mark.skipif(not FULL, reason="lanes are compiled once more for it: make test-in-full")
def test_pushed_arms_in_lanes_move_as_single_ones(tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    scene, count = load_scene(driven_arm(tmp_path)), 11  # more than a group
    fleet = Fleet(scene, count)
    alone = [Plant(scene) for _ in range(count)]
    for _ in range(4):
        for arm, plant in enumerate(alone):
            if rng.random() < 0.7:
                wrenches = sample_wrenches(rng, scene, 20.0)
                push(plant, wrenches)
                push(fleet[arm], wrenches)
        voltages = rng.uniform(-20.0, 20.0, (3, count, 3))
        moved = fleet.run(voltages, 20)
        for arm, plant in enumerate(alone):
            q = plant.run(voltages[:, arm], 20)
            np.testing.assert_allclose(
                moved[:, arm], q, rtol=0.0, atol=1e-11, err_msg=f"q of arm {arm}"
            )
    assert not fleet.diverged


def test_a_load_that_is_taken_up_comes_with_the_speed_of_the_tool(tmp_path: Path) -> None:
    """Angles and speeds do not jump: energy and momentum do, by those of the load that comes.

    A load that is put down takes its own with it.
    """
    rng = np.random.default_rng(10)
    file = driven_arm(tmp_path)
    plant = Plant(load_scene(file))
    for row in rng.uniform(-20.0, 20.0, (10, 3)):
        plant.advance(row, 40)
        before, energy, old = plant.state, plant.energy, plant.parameters["payload.mass"]
        new = float(rng.uniform(0.2, 4.0))
        plant.set_parameter("payload.mass", new)
        after = plant.state
        for name in ("q", "v", "theta_m", "omega_m", "current"):
            np.testing.assert_array_equal(getattr(after, name), getattr(before, name), name)
        assert after.gear_torque[0] == before.gear_torque[0], "torque of the elastic gear"
        models = [
            PushedMachine(load_scene(file, {"payload.mass": mass}), mass).model
            for mass in (old, new)
        ]
        E = [
            pin.computeKineticEnergy(model, model.createData(), before.q, before.v)
            - 0.5 * model.armature @ before.v**2  # of rotors, which are below
            + pin.computePotentialEnergy(model, model.createData(), before.q)
            for model in models
        ]
        # Potential energy is counted from the base link, in both.
        assert plant.energy - energy == pytest.approx(E[1] - E[0], abs=1e-9), "energy"
        assert energy == pytest.approx(E[0] + energy_of_drives(before), rel=1e-9), "all of it"


def energy_of_drives(x: PlantState) -> float:
    """Kinetic energy of the rotors, energy of the windings, and of the elastic gear [J]."""
    rotors = MOTOR["rotor_inertia"] * x.omega_m[:2] ** 2 + MOTOR["inductance"] * x.current[:2] ** 2
    return float(0.5 * rotors.sum() + 0.5 * 2e3 * (0.02 * x.theta_m[0] - x.q[0]) ** 2)


def test_a_scene_without_wrenches_has_nothing_of_them(tmp_path: Path) -> None:
    scene = load_scene("three_axis")
    unit = write_scene_unit(scene)
    assert "external_wrench = false" in unit and "link_axes" not in unit
    plant = Plant(scene)
    saved = plant.save()
    link = scene.chain.joints[-1].link
    with pytest.raises(Refusal, match=r"three_axis\.yaml: external_wrench must be true"):
        plant.set_external_wrench(link, ExternalWrench([1.0, 0.0, 0.0]))
    assert plant.external_wrenches == {} and plant.save() == saved
    for bad in ("yes please", 1, None, [True]):
        file = driven_arm(tmp_path)
        file.write_text(
            yaml.safe_dump({**yaml.safe_load(file.read_text()), "external_wrench": bad})
        )
        with pytest.raises(Refusal, match="external_wrench must be true or false"):
            load_scene(file)


def test_bad_wrenches_are_refused_and_change_nothing(tmp_path: Path) -> None:
    rng = np.random.default_rng(11)
    scene = load_scene(driven_arm(tmp_path))
    plant = Plant(scene)
    push(plant, sample_wrenches(rng, scene, 5.0))
    saved, link = plant.save(), scene.chain.joints[1].link
    bad = [np.nan, np.inf, -np.inf, 1e300, -1e9, "one", None]
    cases = [
        ExternalWrench(**{name: rng.permutation(np.array([1.0, 2.0, value], object)).tolist()})
        for name, value in itertools.product(("force", "moment", "point"), bad)
    ]
    cases += [ExternalWrench([1.0, 2.0]), ExternalWrench(3.0)]  # type: ignore[arg-type]
    cases += [ExternalWrench(axes=axes) for axes in ("tool", "", "World")]
    for wrench in cases:
        with pytest.raises(Refusal) as refusal:
            plant.set_external_wrench(link, wrench)
        assert "\n" not in str(refusal.value) and "must" in str(refusal.value)
        assert plant.save() == saved, f"{wrench} was refused and has changed something"
    for name in ("base", "", "no such link", scene.joint_names[0]):
        with pytest.raises(Refusal, match="link must be one that moves"):
            plant.set_external_wrench(name, ExternalWrench([1.0, 0.0, 0.0]))
        assert plant.save() == saved, name


@pytest.mark.slow
def test_arms_of_a_fleet_are_pushed_together_as_alone() -> None:
    scene = load_scene("three_axis", overrides=LOCATED)
    link, count = scene.chain.joints[2].link, 5
    rng = np.random.default_rng(11)
    force, moment, point = rng.normal(0.0, 20.0, (3, count, 3)) * [[[1.0]], [[0.1]], [[0.01]]]
    for axes in ("link", "world"):
        fleet, alone = Fleet(scene, count), Fleet(scene, count)
        fleet.set_external_wrench(link, ExternalWrench(force, moment, point, axes), arms=[0, 2, 4])
        fleet.set_external_wrench(link, ExternalWrench(force[1], axes=axes), arms=[1])
        for k in (0, 2, 4):
            alone[k].set_external_wrench(link, ExternalWrench(force[k], moment[k], point[k], axes))
        alone[1].set_external_wrench(link, ExternalWrench(force[1], axes=axes))
        assert fleet.save() == alone.save()
        assert [arm.external_wrenches for arm in fleet] == [arm.external_wrenches for arm in alone]
        fleet.advance(np.zeros(3), 20)
        assert np.flatnonzero(np.abs(fleet.state.v).max(axis=1) > 1e-9).tolist() == [0, 1, 2, 4]
    before = fleet.save()
    for wrong in (np.zeros((4, 3)), np.zeros(2), np.full((5, 3), np.nan), np.full(3, 1e10), "x"):
        with pytest.raises(Refusal):
            fleet.set_external_wrench(link, ExternalWrench(wrong))
        assert fleet.save() == before
    with pytest.raises(Refusal, match="external_wrench must be true"):
        Fleet(load_scene("three_axis", SENSED), 2).set_external_wrench(link, ExternalWrench())
