"""Motors that are commanded a torque or a current, against closed forms.

The joints of a gantry do not feel each other: each is a linear machine by itself, whose state at
the end of a period is a matrix exponential.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines import GANTRY, MOVED, ROTOR, gantry_urdf, write_scene
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from arm_emulator import Plant, Refusal, Scene, load_scene, load_servo_config
from arm_emulator.base.io.config_files import find_beside, find_scene
from arm_emulator.runs.gains import check_joints
from oracles.reference import solve_positions

PERIOD = 1e-2  # s, over which a command is held
TORQUE = {"kind": "torque", "rotor_inertia": ROTOR}
CURRENT = {"kind": "current", "torque_constant": 0.1, "rotor_inertia": ROTOR}
ELASTIC, RIGID = {"ratio": 0.01, "stiffness": 2e4, "damping": 20.0}, {"ratio": 0.01}
VISCOUS = {"viscous": 3.0}
# Two libraries with all combinations of motor, gear and bandwidth that matter.
STRUCTURES: dict[str, list[dict[str, Any]]] = {
    "bandwidth": [
        {"motor": {**TORQUE, "bandwidth": 30.0}, "gear": ELASTIC, "friction": VISCOUS},
        {"motor": {**CURRENT, "bandwidth": 50.0, "resistance": 0.5}, "gear": ELASTIC},
        {"motor": {**TORQUE, "bandwidth": 40.0}, "gear": RIGID, "friction": VISCOUS},
    ],
    "at_once": [
        {"motor": {**CURRENT, "current_limit": 4.0}, "gear": RIGID, "friction": VISCOUS},
        {"motor": {**TORQUE, "torque_limit": 0.3}, "gear": ELASTIC},
        {"motor": {**CURRENT, "resistance": 0.7}, "gear": ELASTIC, "friction": VISCOUS},
    ],
}


def write(folder: Path, structure: str) -> Path:
    return write_scene(
        folder, gantry_urdf(), dict(zip(GANTRY, STRUCTURES[structure], strict=True)),
        varied=["joints.*.motor.*", "joints.*.gear.*", "joints.*.friction.viscous"],
        energy_flow=True, integrator={"scheme": "rosenbrock", "dt": 1e-4},
    )  # fmt: skip


@pytest.fixture(scope="module", params=STRUCTURES)
def gantry(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("gantry"), request.param)


def sample_gantry(file: Path, seed: int, dt: float = 1e-4) -> tuple[Scene, Plant, np.ndarray]:
    """The gantry with other numbers, and commands within the limits of its motors."""
    rng = np.random.default_rng([seed, 11])
    scene = load_scene(file, {"integrator.dt": dt})
    plant = Plant(scene)
    for number in scene.varied:
        plant.set_parameter(number.name, number.value * float(rng.uniform(0.5, 2.0)))
    plant.reset()
    return scene, plant, rng.uniform(-0.1, 0.1, (8, 3))


def exact(scene: Scene, plant: Plant, commands: np.ndarray) -> np.ndarray:
    """Rows (current, tm, wm, q, v) of the joints after each period, (K, 5, N)."""
    out = np.zeros((len(commands), 5, 3))
    for j, (joint, M) in enumerate(zip(scene.joints, MOVED, strict=True)):
        at = f"joints.{joint.name}."
        own = {k.removeprefix(at): x for k, x in plant.parameters.items() if k.startswith(at)}
        Mm, Dl = own["motor.rotor_inertia"], own.get("friction.viscous", 0.0)
        Kt, lag = own.get("motor.torque_constant", 1.0), own.get("motor.bandwidth")
        Ng, Kg, Dg = joint.gear.ratio, own.get("gear.stiffness"), own.get("gear.damping", 0.0)
        A, B = np.zeros((5, 5)), np.zeros(5)  # of (s, tm, wm, q, v); s what follows the command
        torque = np.zeros(6)  # on the rotor, of the states and u
        torque[5 if lag is None else 0] = Kt
        if lag is not None:
            A[0, 0], B[0] = -2.0 * np.pi * lag, 2.0 * np.pi * lag
        A[3, 4] = 1.0
        if Kg is None:
            inertia = M + Mm / Ng**2
            A[4], B[4] = torque[:5] / Ng / inertia, torque[5] / Ng / inertia
            A[4, 4] -= Dl / inertia
        else:
            T = np.array([0.0, Ng * Kg, Ng * Dg, -Kg, -Dg])
            A[1, 2] = 1.0
            A[2], B[2] = (torque[:5] - Ng * T) / Mm, torque[5] / Mm
            A[4] = T / M
            A[4, 4] -= Dl / M
        augmented = np.zeros((6, 6))
        augmented[:5, :5], augmented[:5, 5] = A, B
        over = expm(augmented * PERIOD)
        x = np.zeros(5)
        for k, u in enumerate(commands[:, j]):
            x = over[:5, :5] @ x + over[:5, 5] * u
            out[k, :, j] = x
            if lag is None:
                out[k, 0, j] = u
            if Kg is None:
                out[k, 1:3, j] = x[3:5] / Ng
            if joint.unit == "N m":
                out[k, 0, j] = 0.0  # no current is known
    return out


def motion(plant: Plant, commands: np.ndarray) -> np.ndarray:
    rows = []
    for row in commands:
        plant.advance(row, round(PERIOD / plant.scene.integrator.dt))
        x = plant.state
        rows.append([x.current, x.theta_m, x.omega_m, x.q, x.v])
    return np.array(rows)


def test_the_motion_is_a_matrix_exponential_to_second_order(gantry: Path) -> None:
    for seed in range(4):
        errors = []
        for dt in (1e-4, 5e-5):
            scene, plant, commands = sample_gantry(gantry, seed, dt)
            truth = exact(scene, plant, commands)
            size = np.abs(truth).max(axis=0) + 1e-300
            errors.append(float((np.abs(motion(plant, commands) - truth) / size).max()))
        # Order 2: a quarter at half the step, but for the error's next term.
        assert errors[1] < 1e-3 and errors[1] < 0.3 * errors[0] + 1e-12, f"seed {seed}: {errors}"


def test_commands_are_clamped_to_the_motors_own_limits(tmp_path: Path) -> None:
    """Not to the supply, which is 48 V here; without power they are 0."""
    plant = Plant(load_scene(write(tmp_path, "at_once")))
    for _ in range(3):
        plant.exchange(np.array([-7.0, 100.0, 60.0]))
        assert plant.measured.applied.tolist() == [-4.0, 0.3, 60.0], "limit, limit, none"
        assert plant.state.current[[0, 2]] == pytest.approx([-4.0, 60.0]), "currents that follow"
    plant.powered = False
    plant.exchange(np.array([-7.0, 100.0, 60.0]))
    assert plant.measured.applied.tolist() == [0.0, 0.0, 0.0], "commands without power"
    assert np.abs(plant.state.current).max() < 1e-12, "currents without power"


def test_a_motor_that_speeds_up_has_its_energy_from_the_supply(gantry: Path) -> None:
    """From rest, where it is given nothing, to speeds at which it is given much in each step."""
    for seed in range(3):
        _, plant, _ = sample_gantry(gantry, seed)
        for name in plant.parameters:
            if name.endswith("resistance"):
                plant.set_parameter(name, 0.0)  # nothing is given but to what moves
        plant.reset()
        plant.advance([0.5, 0.5, 0.5], 20_000)  # 2 s; would raise Diverged
        assert (plant.state.v > 0.3).all(), "speeds that were reached"


@pytest.mark.slow
def test_motors_that_start_from_rest_receive_their_energy(gantry: Path) -> None:
    """Between any two looks at the energy: at rest these motors are given nothing."""
    for seed in range(100):
        rng = np.random.default_rng([seed, 12])
        dt = float(rng.choice([1e-3, 1e-4, 2e-5, 1e-6]))
        _, plant, commands = sample_gantry(gantry, seed, dt)
        plant.advance(np.zeros(3), int(rng.integers(0, 70)))  # to anywhere between two looks
        for command in commands:
            steps = int(rng.integers(1, 130))
            plant.advance(command * 10.0 ** rng.uniform(-3.0, 2.0), steps)  # or Diverged
        assert plant.energy > 0.0, "nothing moved"


@pytest.mark.parametrize("motor", [TORQUE, CURRENT], ids=lambda motor: motor["kind"])
def test_a_servo_for_voltages_and_the_reference_refuse_them(motor: dict[str, Any]) -> None:
    scene = load_scene("three_axis", {"joints.shoulder.motor": motor})
    servo = load_servo_config(find_beside(find_scene("three_axis"), "servo"))
    words = rf"servo.joints.shoulder.{motor['kind']}_bandwidth must be given: .*, got nothing"
    with pytest.raises(Refusal, match=words):
        check_joints(scene, servo)
    with pytest.raises(
        Refusal, match="shoulder.motor must be a part that the reference".replace(".", "[.]")
    ):
        solve_positions(scene, [[0.0, 0.0, 0.0]], 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["extrapolated"])
def test_quantities_beside_a_torque_that_jumps_keep_order_two(tmp_path: Path, scheme: str) -> None:
    """Friction with the load and ripple take the torque of the command that is there now.

    Nothing stops on the way, so that `step` has nothing to be late for.
    """
    Ng, mu, (k, a) = 0.05, 0.3, (7.0, 0.2)
    R, Kt = 0.7, 0.05
    dc = {"kind": "dc", "rotor_inertia": ROTOR, "resistance": R, "torque_constant": Kt,
          "back_emf_constant": Kt, "friction": {"load": mu}}  # fmt: skip
    joints = {
        "x": {"motor": TORQUE, "friction": {"load": mu}},
        "y": {"motor": {**TORQUE, "ripple": {"waves": [[k, a]]}}},
        "z": {"motor": dc},
    }
    file = write_scene(
        tmp_path, gantry_urdf(), {name: {**joint, "gear": {"ratio": Ng}}
                                  for name, joint in joints.items()},
        servo_period=1e-3, integrator={"scheme": scheme, "dt": 1e-3},
    )  # fmt: skip
    rows = np.random.default_rng(5).uniform(0.3, 1.0, (40, 3)) * np.array([0.5, 0.5, 10.0])
    moved = MOVED + ROTOR / Ng**2

    def rates(_: float, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        q, v = state[:3], state[3:]
        load = u[0] / Ng, u[1] / Ng, Kt / R * (u[2] - Kt * v[2] / Ng) / Ng
        ripple = 1.0 + a * np.sin(k * q[1] / Ng)
        a_ = np.array([(1.0 - mu) * load[0], ripple * load[1], load[2] - mu * abs(load[2])]) / moved
        return np.concatenate([v, a_])

    state, truth = np.array([0.0] * 3 + [0.5] * 3), []
    for u in rows:
        state = solve_ivp(rates, (0.0, 1e-3), state, "DOP853", args=(u,), rtol=1e-11,
                          atol=1e-14).y[:, -1]  # fmt: skip
        truth.append(state[:3])
    errors = []
    for steps in (2, 4, 8, 16):
        plant = Plant(load_scene(file, {"integrator.dt": 1e-3 / steps}))
        plant.reset(v=np.full(3, 0.5))
        errors.append(np.abs(plant.run(rows, steps) - truth).max(axis=0))
    assert (errors[-1] < 1e-7).all(), f"rad or m: {errors}"
    # 64 in three halvings of order 2, 8 of order 1; rounding alone for a torque that is constant.
    assert ((errors[-1] < errors[0] / 40.0) | (errors[-1] < 1e-13)).all(), f"{errors}"
