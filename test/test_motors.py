"""Motors and gears against closed forms of eq. (1), (2) and (4)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines import LINK_INERTIA, MOTOR, one_link_urdf, write_scene
from scipy.linalg import expm

from arm_emulator import Plant, load_scene

GEAR = {"ratio": 0.01, "stiffness": 1e4, "damping": 10.0}
VISCOUS = 0.5  # N m s/rad
VOLTAGE = 10.0


def plant_with(folder: Path, dt: float, motor: Any = MOTOR, gear: Any = GEAR) -> Plant:
    joint = {"motor": motor, "friction": {"viscous": VISCOUS}}
    if gear is not None:
        joint["gear"] = gear
    # Motors that differ in numbers only share a library.
    file = write_scene(folder, one_link_urdf(), {"joint": joint}, varied=["joints.*.motor.*"])
    overrides = {"integrator.dt": dt, "servo_period": 1e-2}
    return Plant(load_scene(file, overrides=overrides))


def test_current_rises_as_in_an_rl_circuit(tmp_path: Path) -> None:
    """i = V/R (1 - exp(-t R/L)), with no back-EMF to disturb it."""
    dt, tau = 1e-5, 1e-3
    plant = plant_with(tmp_path, dt, motor={**MOTOR, "back_emf_constant": 0.0})
    for _ in range(20):
        plant.advance([VOLTAGE], 25)
        exact = VOLTAGE * (1.0 - np.exp(-plant.t / tau))
        # Backward Euler lags by at most dt / (2 tau) of t/tau exp(-t/tau) V/R, to first order.
        bound = VOLTAGE * dt / (2 * tau) * (plant.t / tau) * np.exp(-plant.t / tau)
        current = plant.state.current[0]
        assert current == pytest.approx(exact, abs=1.05 * bound + 1e-12), "the circuit's current"
        steps = round(plant.t / dt)
        discrete = VOLTAGE * (1.0 - (1.0 + dt / tau) ** -steps)
        assert current == pytest.approx(discrete, rel=1e-12), "backward Euler's current"


def linear_machine(gear: bool, inductance: bool) -> tuple[np.ndarray, np.ndarray]:
    """dx/dt = A x + b V of one joint without gravity, from (1), (2) and (4)."""
    R, L, K, Mm = 1.0, 1e-3, 0.05, 1e-4
    Ng, Kg, Dg, M, Dl = 0.01, 1e4, 10.0, LINK_INERTIA, VISCOUS
    if gear:  # x = i, tm, wm, q, v
        A = np.array(
            [
                [-R / L, 0, -K / L, 0, 0],
                [0, 0, 1, 0, 0],
                [K / Mm, -(Ng**2) * Kg / Mm, -(Ng**2) * Dg / Mm, Ng * Kg / Mm, Ng * Dg / Mm],
                [0, 0, 0, 0, 1],
                [0, Ng * Kg / M, Ng * Dg / M, -Kg / M, -(Dg + Dl) / M],
            ]
        )
        b = np.array([1 / L, 0, 0, 0, 0])
    else:  # x = i, q, v, the rotor carried by the link
        inertia = M + Mm / Ng**2
        A = np.array(
            [[-R / L, 0, -K / (L * Ng)], [0, 0, 1], [K / (Ng * inertia), 0, -Dl / inertia]]
        )
        b = np.array([1 / L, 0, 0])
    if inductance:
        return A, b
    # The current follows at once: i = (V - K wm) / R.
    speed = A[0] / (R / L)
    reduced = A[1:, 1:] + np.outer(A[1:, 0], speed[1:])
    return reduced, A[1:, 0] / R + b[1:]


def exact_link(A: np.ndarray, b: np.ndarray, t: float) -> tuple[float, float]:
    """q and v at t of the step response, the last two entries of x."""
    n = len(b)
    augmented = np.zeros((n + 1, n + 1))
    augmented[:n, :n], augmented[:n, n] = A, b * VOLTAGE
    x = expm(augmented * t)[:n, n]
    return float(x[-2]), float(x[-1])


@pytest.mark.parametrize("gear", [True, False], ids=["elastic", "rigid"])
@pytest.mark.parametrize("inductance", [True, False], ids=["RL", "R"])
def test_step_response_converges_to_the_closed_form(
    tmp_path: Path, gear: bool, inductance: bool
) -> None:
    """Two masses and an armature circuit under a voltage step; first order in the step."""
    motor = {k: value for k, value in MOTOR.items() if inductance or k != "inductance"}
    exact = np.array(exact_link(*linear_machine(gear, inductance), t=0.2))
    errors = []
    for dt in (4e-5, 2e-5):
        plant = plant_with(tmp_path, dt, motor, GEAR if gear else {"ratio": 0.01})
        plant.advance([VOLTAGE], round(0.2 / dt))
        errors.append(np.abs(np.array([plant.state.q[0], plant.state.v[0]]) - exact))
    scale = np.abs(exact)
    # dt over the machine's slowest time constants.
    assert np.all(errors[1] / scale < 1e-3), f"relative errors of q and v: {errors[1] / scale}"
    falls = errors[0] / errors[1]
    assert falls == pytest.approx([2.0, 2.0], abs=0.2), "first order of the errors of q and v"


def test_direct_drive_is_a_rigid_gear_of_ratio_one(tmp_path: Path) -> None:
    direct = plant_with(tmp_path, 1e-4, gear=None)
    geared = plant_with(tmp_path, 1e-4, gear={"ratio": 1.0})
    for plant in (direct, geared):
        plant.advance([VOLTAGE], 100)
    assert direct.state.q == geared.state.q, "link with and without a gear"
    assert direct.state.theta_m == direct.state.q, "motor and link"


def test_gear_torque_is_the_torque_on_the_link(tmp_path: Path) -> None:
    """M dv/dt + Dl v = T, elastic and rigid: read from two states one step apart."""
    for gear in (GEAR, {"ratio": 0.01}):
        plant = plant_with(tmp_path, 1e-6, gear=gear)
        plant.advance([VOLTAGE], 1000)
        before = plant.state
        plant.advance([VOLTAGE], 1)
        dv = (plant.state.v[0] - before.v[0]) / 1e-6
        T = LINK_INERTIA * dv + VISCOUS * before.v[0]
        # The motor moves on before the link does: one step of difference.
        reported = before.gear_torque[0]
        assert reported == pytest.approx(T, rel=1e-2), "gear torque, and what moves the link"


def test_voltage_is_limited_by_the_supply(tmp_path: Path) -> None:
    plants = [plant_with(tmp_path, 1e-4) for _ in range(2)]
    plants[0].advance([48.0], 50)
    plants[1].advance([1e6], 50)
    assert plants[0].state.v == plants[1].state.v, "speeds at the supply's voltage and beyond"


def test_current_limit_holds(tmp_path: Path) -> None:
    plant = plant_with(tmp_path, 1e-4, motor={**MOTOR, "current_limit": 2.0})
    reached = []
    for _ in range(100):
        plant.advance([VOLTAGE], 1)
        reached.append(plant.state.current[0])
    assert max(reached) == 2.0, "the largest current"
    # Meanwhile the rotor accelerates with Kt times the limit, the gear still unloaded.
    fresh = plant_with(tmp_path, 1e-6, motor={**MOTOR, "current_limit": 2.0, "inductance": 0.0})
    fresh.advance([VOLTAGE], 10)
    # The gear's torque and damping are below 1e-3 of the motor's after 10 us.
    speed = 0.05 * 2.0 / 1e-4 * 1e-5
    assert fresh.state.omega_m[0] == pytest.approx(speed, rel=2e-3), "the rotor at the limit"


def test_encoder_counts_are_the_floor_of_the_motor_angle(tmp_path: Path) -> None:
    joint = {"motor": MOTOR, "gear": GEAR, "encoder": {"counts_per_turn": 1000}}
    file = write_scene(tmp_path, one_link_urdf(), {"joint": joint})
    plant = Plant(load_scene(file))
    for turns, counts in ((0.0, 0), (0.0015, 1), (-0.0005, -1), (-2.5004, -2501)):
        plant.reset(q=[turns * 2 * np.pi * 0.01])
        assert plant.measured.encoder_counts[0] == counts, f"counts after {turns} motor turns"
