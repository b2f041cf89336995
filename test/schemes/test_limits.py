"""Currents at their limits: the motion is that of the equations, at any step."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some, with_slow
from machines import LINK_INERTIA, MOTOR, make_link_urdf, write_scene
from scipy.linalg import expm
from scipy.optimize import brentq

from arm_emulator import Plant, Scene, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.machine.schemes.known import SCHEMES
from oracles.reference import solve_positions


def sample_three_axis(
    seed: int, scheme: str, dt: float, events: str = "step"
) -> tuple[Scene, Array]:
    """A three_axis arm without inductance, its light rotors at their limits, and its voltages."""
    rng = np.random.default_rng(seed)
    motor = {
        "inductance": None,
        "rotor_inertia": float(10 ** rng.uniform(-7, -4)),
        "back_emf_constant": float(rng.uniform(0.03, 0.1)),
        "current_limit": float(rng.uniform(0.5, 5.0)),
    }
    gear = {
        "stiffness": float(10 ** rng.uniform(2, 4)),
        "damping": float(rng.choice([0.0, 1.0])) or None,
    }
    overrides: dict[str, Any] = {f"joints.*.motor.{key}": value for key, value in motor.items()}
    overrides |= {f"joints.*.gear.{key}": value for key, value in gear.items()}
    overrides |= {"integrator.scheme": scheme, "integrator.dt": dt, "integrator.events": events}
    overrides |= {"varied": ["joints.*"]}  # one library for all of them
    return load_scene("three_axis", overrides=overrides), rng.uniform(-30.0, 30.0, size=(4, 3))


@pytest.mark.slow
@pytest.mark.parametrize("seed", some(range(1, 4), 2))
def test_limited_motors_without_inductance_move_as_the_equations_state(seed: int) -> None:
    """Rotors that start within a step: near at 1 ms, of second order where steps resolve them."""
    period = 0.02
    scene, voltages = sample_three_axis(seed, "rosenbrock", 1e-3)
    truth = solve_positions(scene, voltages, period, 1e-10, method="LSODA")
    errors = []
    for dt in (1e-3, 1e-4, 1e-5):
        scene, _ = sample_three_axis(seed, "rosenbrock", dt)
        q = Plant(scene).run(voltages, round(period / dt))
        errors.append(float(np.abs(q - truth).max()))
    moved = np.abs(truth - scene.start).max()
    # Drawn time constants go down to a thirteenth of 1 ms. The limit then holds for half a step
    # until each rotor has its speed: the links' error is a part of their first step.
    assert errors[0] < 0.03 * moved and errors[1] < 0.01 * moved, errors
    # Second order, down to the reference's own error.
    assert errors[2] < 0.05 * errors[1] + 1e-9, errors
    scene, _ = sample_three_axis(seed, "rosenbrock", 1e-3, events="located")
    off = np.abs(Plant(scene).run(voltages, 20) - truth).max()
    assert off < 0.03 * moved, f"where steps are cut, {off} of {moved} rad"


PIECE = 1e-4  # s, in which a current meets or leaves its limit once at most


def limited_truth(
    motor: dict[str, float], gear: dict[str, float], V: Array, period: float
) -> Array:
    """One joint by matrix exponentials, the instants at which its current meets or leaves the limit
    located: (i, tm, wm, q, v) after each row of V."""
    R, L, Kt, Kb, Mm, limit = (
        motor[key]
        for key in (
            "resistance",
            "inductance",
            "torque_constant",
            "back_emf_constant",
            "rotor_inertia",
            "current_limit",
        )
    )
    Ng, Kg, Dg = gear["ratio"], gear["stiffness"], gear["damping"]
    i, tm, wm, q, v, constant = np.eye(6)
    twist, rate = Ng * tm - q, Ng * wm - v
    T = Kg * twist + Dg * rate
    x, out = np.array([0.0, 0, 0, 0, 0, 1.0]), []
    for volts in V:
        surplus = volts * constant - R * i - Kb * wm
        rows = [wm, (Kt * i - Ng * T) / Mm, v, T / LINK_INERTIA, 0.0 * constant]
        free, holding = np.array([surplus / L, *rows]), np.array([0.0 * constant, *rows])
        flows = {at_limit: (A, expm(A * PIECE)) for at_limit, A in ((False, free), (True, holding))}
        left = period
        while left > 1e-15:
            side = np.sign(x[0]) if abs(x[0]) >= limit * (1 - 1e-12) else 0.0
            at_limit = side != 0.0 and side * (surplus @ x) >= 0.0
            A, flow = flows[at_limit]
            step = min(PIECE, left)

            def distance(y: Array, at_limit: bool = at_limit, side: float = side,
                         surplus: Array = surplus) -> float:  # fmt: skip
                return float(side * (surplus @ y) if at_limit else limit - abs(y[0]))

            def after(t: float, A: Array = A, x: Array = x) -> Array:
                y: Array = expm(A * t) @ x
                return y

            y = flow @ x if step == PIECE else after(step)
            if distance(y) < -1e-13 and distance(after(1e-12)) > 0.0:
                step = brentq(lambda t, at=after, to=distance: to(at(t)), 1e-12, step, xtol=1e-14)
                y = after(step)
            x = y
            x[0] = np.clip(x[0], -limit, limit)
            left -= step
        out.append(x[:5].copy())
    return np.array(out)


def sample_joint(seed: int) -> tuple[dict[str, float], dict[str, float], Array]:
    """An inductive motor whose current meets its limit, its gear, and voltages."""
    rng = np.random.default_rng(seed)
    motor = {
        **MOTOR,
        "inductance": float(10 ** rng.uniform(-4, -2)),
        "rotor_inertia": float(10 ** rng.uniform(-5, -3.5)),
        "current_limit": float(rng.uniform(2.0, 8.0)),
    }
    gear = {"ratio": 0.01, "stiffness": float(10 ** rng.uniform(3, 4.5)), "damping": 5.0}
    return motor, gear, rng.uniform(-40.0, 40.0, size=8)


@pytest.mark.parametrize(("seed", "scheme"), with_slow(some(enumerate(SCHEMES), 2), 1))
def test_the_error_at_limits_vanishes_with_the_step(tmp_path: Path, seed: int, scheme: str) -> None:
    """A current that meets and leaves its limit within steps costs no more than their size."""
    motor, gear, V = sample_joint(seed)
    truth = limited_truth(motor, gear, V, 0.01)[:, 3]
    file = write_scene(tmp_path, make_link_urdf(), {"joint": {"motor": motor, "gear": gear}})
    errors = []
    for dt in (1e-4, 2.5e-5):
        integrator = {"integrator.dt": dt, "integrator.scheme": scheme}
        plant = Plant(load_scene(file, overrides={"servo_period": 1e-2, **integrator}))
        q = []
        for volts in V:
            for _ in range(20):
                plant.advance([volts], round(0.01 / dt / 20))
                beyond = abs(plant.state.current[0]) / motor["current_limit"] - 1.0
                assert beyond < 1e-9, f"the limit is passed by {beyond:.2g} of it"
            q.append(plant.state.q[0])
        errors.append(float(np.abs(np.array(q) - truth).max()))
    # First order at least; where the coarse step is lucky the fine one is small anyway.
    assert errors[1] < max(0.45 * errors[0], 1e-3 * np.abs(truth).max()), errors


@pytest.mark.slow
def test_a_limit_far_beyond_reach_changes_no_bit() -> None:
    voltages = np.random.default_rng(5).uniform(-20.0, 20.0, size=(50, 3))
    runs = []
    for limit in (1e6, 1e9):
        overrides = {"joints.*.motor.current_limit": limit, "varied": ["joints.*"]}
        runs.append(Plant(load_scene("three_axis", overrides=overrides)).run(voltages, 10))
    assert (runs[0] == runs[1]).all(), "a limit that is never met has changed the motion"


@pytest.mark.parametrize("seed", range(1, 4))
def test_a_motor_that_reverses_within_a_step_is_followed(seed: int) -> None:
    """There may be no modes that hold for a whole step; the motion goes on, near the fine one."""
    voltages = np.repeat(np.random.default_rng(seed).uniform(-30.0, 30.0, size=(20, 3)), 5, axis=0)
    coarse, fine = (
        Plant(sample_three_axis(seed, "rosenbrock", dt)[0]).run(voltages, round(0.01 / dt))
        for dt in (1e-3, 5e-5)
    )
    # Of the way that the arm goes in all; each reversal costs what the first step costs above.
    travel = np.abs(np.diff(fine, axis=0)).sum(axis=0).max()
    assert np.abs(coarse - fine).max() < 0.05 * travel, f"of a way of {travel:.3g} rad"
