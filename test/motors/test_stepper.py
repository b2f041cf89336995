"""A stepper against the pendulum that its currents make of it, and against its load angle."""

from pathlib import Path

import numpy as np
import pytest
from machines import GANTRY, MOVED, ROTOR, gantry_urdf, write_scene

from arm_emulator import Plant, load_scene

KT, TEETH, RATIO, G = 0.2, 50, 1e-3, 9.81
MOTOR = {"kind": "stepper", "torque_per_current": KT, "teeth": TEETH, "rotor_inertia": ROTOR,
         "bandwidth": 2000.0, "resistance": 1.5}  # fmt: skip
J = ROTOR + MOVED * RATIO**2
LOAD = MOVED[2] * G * RATIO  # N m, of the weight at the rotor of z


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rigid gears, a weight on the last; its friction is a number of the machine."""
    joints = {
        name: {"motor": MOTOR, "gear": {"ratio": RATIO}, "friction": {"viscous": 0.0}}
        for name in GANTRY
    }
    return write_scene(
        tmp_path_factory.mktemp("gantry"), gantry_urdf(), joints, gravity=[0.0, 0.0, -G],
        varied=["joints.*.friction.viscous"], energy_flow=True,
        integrator={"scheme": "rosenbrock", "dt": 2e-5},
    )  # fmt: skip


def damped(file: Path) -> Plant:
    plant = Plant(load_scene(file))
    for name, moved in zip(GANTRY, J / RATIO**2, strict=True):
        plant.set_parameter(f"joints.{name}.friction.viscous", 200.0 * moved)
    return plant


def turn(plant: Plant, current: float, phi: np.ndarray | float, periods: int) -> None:
    a, b = (current * np.broadcast_to(x, 3) for x in (np.cos(phi), np.sin(phi)))
    for _ in range(periods):
        plant.exchange(a, command_b=b)


def test_constant_currents_make_a_pendulum(file: Path) -> None:
    """J wm^2 / 2 - Kt I / p cos(p tm - phi) rests, far beyond small swings."""
    errors = []
    for dt in (4e-5, 2e-5):
        plant, energy = Plant(load_scene(file, {"integrator.dt": dt})), []
        plant.exchange(np.full(3, 1.0), command_b=np.full(3, 2.0))
        turn(plant, 1.0, 2.0, 10)  # twenty time constants of the drivers and more
        for _ in range(50):
            turn(plant, 1.0, 2.0, 1)
            theta, omega = plant.state.theta_m[:2], plant.state.omega_m[:2]
            energy.append(0.5 * J[:2] * omega**2 - KT / TEETH * np.cos(TEETH * theta - 2.0))
        errors.append(float(np.ptp(energy, axis=0).max() / (KT / TEETH)))
    assert errors[1] < 1e-3 and errors[1] < 0.3 * errors[0], f"{errors}"


def test_microsteps_turn_the_rotor_and_a_weight_makes_it_lag(file: Path) -> None:
    plant, current = damped(file), 1.0
    for step in range(33):  # of 1/16 of a full step, two full steps and one microstep
        phi = 0.5 * np.pi * step / 16
        turn(plant, current, phi, 20)
    turn(plant, current, phi, 1000)
    lag = np.array([0.0, 0.0, np.arcsin(LOAD / (KT * current))])
    assert plant.state.theta_m == pytest.approx((phi - lag) / TEETH, abs=1e-9)
    assert plant.measured.applied_b == pytest.approx(current * np.sin(phi), abs=1e-12)


def test_a_weight_above_the_torque_of_the_currents_sinks(file: Path) -> None:
    for share, holds in ((1.05, True), (0.95, False)):
        plant = damped(file)
        turn(plant, share * LOAD / KT, -0.5 * np.pi, 3000)
        assert (plant.state.theta_m[2] > -2.0 * np.pi / TEETH) == holds
