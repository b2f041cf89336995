"""The linear machine is the derivative of the machine: every entry of A and B, on every scene.

The truth is `oracles.reference` and `oracles.event_reference`, in NumPy and Pinocchio, by central
differences; what they do not know, by what must follow from how the machine stands.
"""

import dataclasses
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from draws import some, with_slow
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from arm_emulator import LinearMachine, Plant, Refusal, Scene, linearise, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.machine.parts.drive_stages.current_loop import CurrentLoop
from arm_emulator.machine.parts.motors.dc_motor import DcMotor
from arm_emulator.machine.parts.motors.torque_motor import TorqueMotor
from oracles.event_reference import MachineWithModes
from oracles.reference import ReferenceMachine, make_links_model

# Without what the references do not have, see below for that.
ROTORS = {f"joints.axis_{k}.motor.friction": None for k in range(1, 7)}
SCENES: dict[str, dict[str, Any]] = {
    "three_axis": {}, "ur5": {}, "kuka_kr300": {**ROTORS, "joints.axis_2.counterbalance": None},
    "manutec_r3": {key: None for key in list(ROTORS)[:3]}, "panda": {},
}  # fmt: skip
CURRENT, TM, WM, Q, V, INTEGRAL = range(6)  # rows of a reference's state


def places(scene: Scene) -> list[tuple[int, int]]:
    """Row and joint in a reference's state for each number of x."""
    own = []
    for j, joint in enumerate(scene.joints):
        if isinstance(joint.motor, DcMotor) and joint.motor.inductance > 0.0:
            own.append((CURRENT, j))
        if joint.find_part(CurrentLoop) is not None:
            own.append((INTEGRAL, j))
        if joint.motor is not None and joint.gear.stiffness is not None:
            own += [(TM, j), (WM, j)]
    return own + [(row, j) for row in (Q, V) for j in range(len(scene.joints))]


def derivatives(machine: ReferenceMachine, scene: Scene, of: LinearMachine) -> tuple[Array, ...]:
    N, at = machine.N, places(scene)
    x = np.zeros((6, N))
    for value, place in zip(of.x0, at, strict=True):
        x[place] = value

    def rates(x: Array, u: Array) -> Array:
        dx = machine.compute_rates(0.0, x.ravel(), u).reshape(6, N)
        return np.array([dx[place] for place in at])

    columns, h = [], 2.0**-12
    for k in range(len(at) + N):
        column = np.zeros(len(at))
        for place, factor in ((-2, 1.0), (-1, -8.0), (1, 8.0), (2, -1.0)):  # exact for cubes
            some, u = x.copy(), of.u0.copy()
            if k < len(at):
                some[at[k]] += place * h
            else:
                u[k - len(at)] += place * h
            column += factor * rates(some, u) / (12.0 * h)
        columns.append(column)
    table = np.array(columns).T
    table[of.q.start + np.flatnonzero(of.sticks)] = 0.0  # there the speed is no number but 0
    return table[:, : len(at)], table[:, len(at) :], rates(x, of.u0)


def as_dc(scene: Scene) -> Scene:
    """The same with ideal torque motors as DC motors: a command of 1 is 1 N m."""
    joints = tuple(
        dataclasses.replace(
            joint,
            motor=DcMotor(
                resistance=1.0, torque_constant=1.0, back_emf_constant=0.0,
                rotor_inertia=joint.motor.rotor_inertia, current_limit=joint.motor.torque_limit,
            ),
        )
        if isinstance(joint.motor, TorqueMotor)
        else joint
        for joint in scene.joints
    )  # fmt: skip
    return dataclasses.replace(scene, joints=joints)


def assert_same(actual: Array, expected: Array, rounding: Array) -> None:
    """Every entry, to what central differences and rounding of large torques leave in its row."""
    off = np.abs(actual - expected) - 1e-6 * np.abs(expected)
    worst = np.unravel_index(int(np.argmax(off - rounding)), off.shape)
    assert (off <= rounding).all(), f"{worst}: {actual[worst]} is not {expected[worst]}"


def compare(machine: ReferenceMachine, scene: Scene, of: LinearMachine) -> None:
    A, B, rate = derivatives(machine, scene, of)
    row = np.abs(A).max(axis=1, keepdims=True) + np.abs(B).max(axis=1, keepdims=True)
    assert_same(of.A, A, 1e-9 * row + 1e-9)
    assert_same(of.B, B, 1e-9 * row + 1e-9)
    assert_same(of.rate[:, np.newaxis], rate[:, np.newaxis], 1e-10 * row + 1e-9)


@pytest.fixture(params=with_slow(some(SCENES, 3), 1), scope="module")
def scene(request: pytest.FixtureRequest) -> Scene:
    return load_scene(request.param, overrides=SCENES[request.param])


def test_about_rest_every_entry_is_that_of_the_equations(scene: Scene) -> None:
    payload = yaml.safe_load(find_scene(scene.name).read_text()).get("payload")
    machine = ReferenceMachine(as_dc(scene), payload, smooth=False)
    rng = np.random.default_rng(7)
    plant = Plant(scene)
    for q in (scene.start, scene.start + rng.uniform(-0.3, 0.3, len(scene.joints))):
        linear = linearise(plant, q)
        assert np.allclose(linear.x0[linear.q], q) and not linear.sticks.any()
        assert np.abs(linear.rate).max() < 1e-4 * np.abs(linear.A).max(), "the commands hold it"
        compare(machine, scene, linear)
        # Held by these commands the machine itself stays: the residual is friction's.
        assert np.array_equal(plant.state.q, Plant(scene).state.q), "the plant has not moved"


def test_in_motion_every_entry_is_that_of_the_equations(scene: Scene) -> None:
    """With joints that stick, and that slide with gears wound up, at speed."""
    if scene.name == "manutec_r3":
        pytest.skip("the reference with modes has no payload")
    plant, N = Plant(scene), len(scene.joints)
    rng = np.random.default_rng(8)
    stuck = slid = 0
    for _ in range(4):
        command = rng.uniform(-0.3, 0.3, N) * np.where(rng.random(N) < 0.5, 0.0, 5.0)
        for _ in range(30):
            plant.exchange(command)
        linear = linearise(plant)
        machine = MachineWithModes(as_dc(scene))
        x = np.zeros((6, N))
        for value, place in zip(linear.x0, places(scene), strict=True):
            x[place] = value
        machine.choose_sides(x, linear.u0)
        machine.choose_locks(x, linear.u0)
        assert np.array_equal(machine.locked, linear.sticks)
        stuck, slid = stuck + linear.sticks.sum(), slid + (~linear.sticks).sum()
        compare(machine, scene, linear)
    assert slid > 0 and (stuck > 0 or all(joint.friction.coulomb == 0.0 for joint in scene.joints))


def inertia(scene: Scene, joint: int) -> float:
    """Of a rotor [kg m2]."""
    return float(getattr(scene.joints[joint].motor, "rotor_inertia"))  # noqa: B009


@pytest.mark.slow
@pytest.mark.parametrize("name", some(["kuka_kr300", "manutec_r3"], 1))
def test_friction_of_rotors_and_a_counterbalance_act_at_their_places_alone(name: str) -> None:
    """Friction at speeds of rotors, a counterbalance as a spring by its potential."""
    bare = load_scene(name, overrides=SCENES[name])  # axes 1 to 3 have elastic gears
    full = load_scene(name, overrides=dict.fromkeys(SCENES[name].keys() & list(ROTORS)[3:]))
    q = bare.start + 0.2
    linear, second = (linearise(Plant(variant), q) for variant in (full, bare))
    expected, at = second.A.copy(), places(as_dc(bare))
    for j, joint in enumerate(full.joints):
        if joint.rotor_friction is not None and joint.motor is not None and j < 3:
            k = at.index((WM, j))
            expected[k, k] -= joint.rotor_friction.viscous / inertia(full, j)
    if name == "kuka_kr300":
        M = Plant(bare).links.mass_matrix(q)
        for j in range(3, 6):  # rigid gears carry their rotors
            M[j, j] += inertia(bare, j) / bare.joints[j].gear.ratio ** 2
        stiffness = counterbalance_stiffness(full, bare, q)
        bent = M @ (linear.A - expected)[linear.v, linear.q]
        # Wound-up gears are as they were: the motor holds less. Second differences of some kJ.
        assert bent[1, 1] == pytest.approx(-stiffness, rel=1e-4)
        bent[1, 1] = 0.0
        assert np.abs(bent).max() < 1e-5 * abs(stiffness)
        expected[linear.v, linear.q] = linear.A[linear.v, linear.q]
    assert_same(linear.A, expected, 1e-10 * np.abs(expected).max(axis=1, keepdims=True))
    assert not np.array_equal(linear.A, second.A)


def counterbalance_stiffness(full: Scene, bare: Scene, q: Array) -> float:
    """Return the second derivative of its potential by the angle of the second joint."""
    h, potential = 1e-4, []
    for place in (-1.0, 0.0, 1.0):
        plants = Plant(full), Plant(bare)
        for plant in plants:
            plant.reset(q + place * h * np.eye(6)[1])
        potential.append(plants[0].energy - plants[1].energy)
    return float((potential[0] - 2.0 * potential[1] + potential[2]) / h**2)


# Each acts in a test of its own, and leaves those of the others alone.
LOOSE = {
    "joints.elbow.gear.backlash": 2e-3,
    "joints.waist.motor.current_limit": 2.0,
    "joints.waist.end_stops": {"lower": -1.0, "upper": 0.5, "stiffness": 1e4, "damping": 20.0},
}


VARIED = {"varied": ["joints.*"]}  # share the library of machines that differ in numbers alone


def in_three_axis(**keys: Any) -> Plant:
    return Plant(load_scene("three_axis", overrides=keys))


@pytest.mark.slow
def test_a_gear_with_play_pulls_where_it_touches() -> None:
    plant, plain = in_three_axis(**LOOSE), in_three_axis()
    N = slice(-3, None)
    linear, second = linearise(plant), linearise(plain)
    elbow = np.abs(linear.theta_m[2]).argmax()
    size = np.abs(second.A[N]).max()
    assert np.abs(linear.A[N, elbow]).max() < 1e-12 * size, "in the play nothing touches"
    assert np.abs(second.A[N, elbow]).max() > 1e-3 * size
    plant.put("test", {"theta_m": plant.state.theta_m + np.array([0.0, 0.0, 0.2])})
    touching = linearise(plant).A[:, elbow : elbow + 2]  # the links' own pull at each other changes
    assert_same(touching, second.A[:, elbow : elbow + 2], np.full((15, 2), 1e-9 * size))
    with pytest.raises(Refusal, match="motors and springs hold"):
        linearise(in_three_axis(gravity=[0, -9.81, 0], **LOOSE), [0.0, 0.5, 0.8])


@pytest.mark.slow
def test_a_current_at_its_limit_stays_there() -> None:
    plant = in_three_axis(**LOOSE)
    plant.advance([40.0, 0.0, 0.0], 5)
    assert plant.state.current[0] == pytest.approx(2.0)
    linear = linearise(plant, command=[40.0, 0.0, 0.0])
    for rests in (linear.B[:, 0], linear.current[0], linear.current_by_u[0]):
        assert np.abs(rests).max() < 1e-9
    assert np.abs(linear.B[:, 1]).max() == pytest.approx(1e3, rel=1e-9)  # 1/L


def test_a_link_that_sticks_rests_and_a_link_that_slides_does_not() -> None:
    plant = in_three_axis(**VARIED, **{"joints.waist.friction.coulomb": 5.0})
    linear = linearise(plant)
    assert linear.sticks.tolist() == [True, False, False]
    resting = [linear.q.start, linear.v.start]
    assert not linear.A[resting].any() and not linear.B[resting].any()
    # About rest in a pose there is no dry friction: design is for what moves.
    plain = in_three_axis(**VARIED)
    assert np.array_equal(linearise(plant, plant.scene.start).A, linearise(plain).A)


def test_an_end_stop_is_a_spring_where_it_is_pressed() -> None:
    plant, plain = in_three_axis(**LOOSE), in_three_axis()
    for machine in (plant, plain):
        machine.reset([0.52, 0.5, 0.8])
    linear, second = linearise(plant), linearise(plain)
    M = plain.links.mass_matrix([0.52, 0.5, 0.8])
    pressed = M @ (linear.A - second.A)[linear.v]
    for first, expected in ((linear.q.start, -1e4), (linear.v.start, -20.0)):
        np.testing.assert_allclose(pressed[:, first], [expected, 0.0, 0.0], atol=1e-4)
    assert (M @ linear.rate[linear.v])[0] == pytest.approx(-1e4 * 0.02)


@pytest.mark.slow
def test_a_joint_without_a_motor_rests_where_its_spring_bears_the_weight() -> None:
    """The truth is Pinocchio's gravity and SciPy's table; the elbow sags by some mrad."""
    angles, torques = np.array([-2.0, -0.5, 0.5, 2.0]), np.array([300.0, 90.0, -90.0, -300.0])
    table = {"angles": (angles + 0.8).tolist(), "torques": torques.tolist()}
    gravity = [3.0, -9.0, 2.0]
    scene = load_scene("three_axis", {
        "gravity": gravity, "joints.elbow": {"torque_table": table, "friction": {"viscous": 5.0}},
    })  # fmt: skip
    plant, spring = Plant(scene), PchipInterpolator(angles + 0.8, torques)
    model = make_links_model(scene)
    data, rng = model.createData(), np.random.default_rng(5)
    per_volt = np.array([joint.torque_per_command for joint in scene.joints])
    for q in scene.start + rng.uniform(-0.3, 0.3, (5, 3)):
        q[2] = 0.8
        linear = linearise(plant, q)

        def torque(elbow: float, q: Array = q) -> float:
            weight = pin.computeGeneralizedGravity(model, data, np.array([*q[:2], elbow]))[2]
            return float(spring(elbow) - weight)

        rest = brentq(torque, 0.4, 1.2, xtol=1e-14)
        assert abs(rest - 0.8) > 1e-4
        np.testing.assert_allclose(linear.x0[linear.q], [*q[:2], rest], rtol=0.0, atol=1e-9)
        weight = pin.computeGeneralizedGravity(model, data, linear.x0[linear.q])
        np.testing.assert_allclose(per_volt * linear.u0, [*weight[:2], 0.0], atol=1e-8)
        assert np.abs(linear.rate).max() < 1e-5, "1e-10 of the derivatives, up to 1e5"
        # The drives' torques stand while the elbow turns; its spring and damper do not.
        h, place = 1e-5, linear.q.start + 2

        def accelerate(
            dq: float, v: float, q: Array = q, rest: float = rest, weight: Array = weight
        ) -> Array:
            elbow = rest + dq
            tau = np.array([*weight[:2], spring(elbow) - 5.0 * v])
            at, speeds = np.array([*q[:2], elbow]), np.array([0.0, 0.0, v])
            return np.array(pin.aba(model, data, at, speeds, tau))

        by_q = (accelerate(h, 0.0) - accelerate(-h, 0.0)) / (2.0 * h)
        by_v = (accelerate(0.0, h) - accelerate(0.0, -h)) / (2.0 * h)
        actual = linear.A[linear.v][:, [place, place + 3]]
        np.testing.assert_allclose(actual, np.column_stack([by_q, by_v]), rtol=1e-5, atol=1e-6)


def test_a_current_without_inductance_is_no_state_and_follows_the_command() -> None:
    linear = linearise(in_three_axis(**VARIED, **{"joints.*.motor.inductance": None}))
    assert linear.A.shape == (12, 12)
    np.testing.assert_allclose(linear.current_by_u, np.eye(3), atol=1e-12)  # 1/R, 1 ohm
    np.testing.assert_allclose(linear.current, -0.05 * omega_m(linear), atol=1e-12)


def omega_m(linear: LinearMachine) -> Array:
    """Motor speeds by x: the rates of their angles, which are states."""
    return linear.theta_m @ linear.A


def test_states_that_a_machine_cannot_have_are_refused() -> None:
    plant = in_three_axis()
    assert linearise(plant, command=[1e30, 0.0, -1e30]).u0.tolist() == [48.0, 0.0, -48.0]
    for wrong in ([1.0], [np.nan] * 3, "x", [True] * 3):
        with pytest.raises(Refusal):
            linearise(plant, wrong)
        with pytest.raises(Refusal):
            linearise(plant, command=wrong)
    with pytest.raises(Refusal, match="command must be absent in a pose"):
        linearise(plant, plant.scene.start, command=[0.0] * 3)
