"""Permanent-magnet synchronous motors against an independent solution; energy: test_winding.py."""

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from draws import some
from machines import list_moving_joints, write_random_chain, write_scene
from scipy.integrate import solve_ivp

from arm_emulator import Plant, Refusal, Scene, load_scene
from arm_emulator.machine.parts.motors.pmsm import Pmsm
from oracles.reference import make_links_model

PERIOD = 1e-3  # s, over which a command is held
SUPPLY = 48.0
AMPLITUDE = SUPPLY / math.sqrt(3.0)  # V, largest of a phase


def draw_motor(rng: np.random.Generator) -> dict[str, Any]:
    """A motor of any saliency, with electrical time constants of 1 to 10 ms."""
    resistance = float(rng.uniform(0.2, 1.0))
    Ld, Lq = (resistance * 10 ** rng.uniform(-3.0, -2.0, 2)).tolist()
    return {
        "kind": "pmsm", "resistance": resistance, "inductance_d": Ld, "inductance_q": Lq,
        "flux": float(rng.uniform(0.005, 0.02)), "pole_pairs": int(rng.integers(2, 8)),
        "rotor_inertia": float(10 ** rng.uniform(-4.5, -3.5)),
    }  # fmt: skip


def draw_arm(folder: Path, seed: int) -> Path:
    """Three random joints: elastic, rigid and elastic gears; gravity aslant."""
    rng = np.random.default_rng([seed, 31])
    urdf = write_random_chain(rng, 3)
    joints = {}
    for k, name in enumerate(list_moving_joints(urdf)):
        gear = {"ratio": float(rng.uniform(0.02, 0.05))}
        if k != 1:
            gear |= {"stiffness": float(rng.uniform(1e3, 3e3)), "damping": float(rng.uniform(1, 5))}
        joints[name] = {"motor": draw_motor(rng), "gear": gear, "friction": {"viscous": 0.2}}
    return write_scene(
        folder, urdf, joints, gravity=[1.0, -2.0, -9.0], servo_period=PERIOD,
        supply_voltage=SUPPLY, integrator={"scheme": "rosenbrock", "dt": 1e-4},
    )  # fmt: skip


def draw_commands(rng: np.random.Generator, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Voltages ud and uq (K, 3) within the circle."""
    size = AMPLITUDE * np.sqrt(rng.uniform(0.0, 1.0, (rows, 3)))
    angle = rng.uniform(-np.pi, np.pi, (rows, 3))
    return size * np.cos(angle), size * np.sin(angle)


def state_of(plant: Plant) -> np.ndarray:
    x = plant.state
    return np.array([plant.measured.current_d, x.current, x.theta_m, x.omega_m, x.q, x.v])


def solved(scene: Scene, ud: np.ndarray, uq: np.ndarray) -> np.ndarray:
    """States (K, 6, 3) as `get_state` after each command, by DOP853 from the motor's equations."""
    motors = [joint.motor for joint in scene.joints]
    assert all(isinstance(motor, Pmsm) for motor in motors)
    names = "resistance", "inductance_d", "inductance_q", "flux", "pole_pairs", "rotor_inertia"
    R, Ld, Lq, psi, p, Mm = (np.array([getattr(motor, name) for motor in motors]) for name in names)
    gears = [joint.gear for joint in scene.joints]
    rigid = np.array([gear.stiffness is None for gear in gears])
    Ng, Kg, Dg = (
        np.array([getattr(gear, name) or 0.0 for gear in gears])
        for name in ("ratio", "stiffness", "damping")
    )
    Dl = np.array([joint.friction.viscous for joint in scene.joints])
    model = make_links_model(scene, None)
    model.armature = np.where(rigid, Mm / Ng**2, 0.0)
    data = model.createData()

    def rates(t: float, flat: np.ndarray, d: np.ndarray, across: np.ndarray) -> np.ndarray:
        i_d, i_q, tm, wm, q, v = flat.reshape(6, 3)
        wm = np.where(rigid, v / Ng, wm)
        shaft = 1.5 * p * (psi * i_q + (Ld - Lq) * i_d * i_q)
        T = np.where(rigid, shaft / Ng, Kg * (Ng * tm - q) + Dg * (Ng * wm - v))
        a = pin.aba(model, data, q, v, T - Dl * v)
        return np.concatenate([
            (d - R * i_d + p * wm * Lq * i_q) / Ld,
            (across - R * i_q - p * wm * (Ld * i_d + psi)) / Lq,
            np.where(rigid, 0.0, wm), np.where(rigid, 0.0, (shaft - Ng * T) / Mm), v, a,
        ])  # fmt: skip

    x, out = np.zeros((6, 3)), []
    x[4] = scene.start
    x[2] = scene.start / Ng
    for row in zip(ud, uq, strict=True):
        end = solve_ivp(rates, (0.0, PERIOD), x.ravel(), "DOP853", rtol=1e-13, atol=1e-15, args=row)
        x = end.y[:, -1].reshape(6, 3)
        reported = x.copy()
        reported[2:4] = np.where(rigid, x[4:6] / Ng, x[2:4])
        out.append(reported)
    return np.array(out)


def motion(file: Path, steps: int, ud: np.ndarray, uq: np.ndarray) -> np.ndarray:
    """The same by the machine, in so many steps per command."""
    plant, rows = Plant(load_scene(file, {"integrator.dt": PERIOD / steps})), []
    for d, across in zip(ud, uq, strict=True):
        plant.exchange(across, command_d=d)
        rows.append(state_of(plant))
    return np.array(rows)


@pytest.fixture(scope="module", params=some(range(2), 1))
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return draw_arm(tmp_path_factory.mktemp("arm"), request.param)


def test_the_motion_is_that_of_an_independent_solution_to_1e_11(arm: Path) -> None:
    """In the limit of small steps: extrapolated from steps of 25 to 0.8 us."""
    ud, uq = draw_commands(np.random.default_rng(5), 10)
    truth = solved(load_scene(arm), ud, uq)
    size = np.abs(truth).max(axis=0)
    levels = [motion(arm, 40 * 2**k, ud, uq) for k in range(6)]
    errors = [float((np.abs(level - truth) / size).max()) for level in levels]
    assert 3.5 < errors[2] / errors[3] < 4.5, f"order 2 by halves: {errors}"
    for power in range(2, 7):
        factor = 2.0**power
        levels = [(factor * b - a) / (factor - 1.0) for a, b in itertools.pairwise(levels)]
    error = float((np.abs(levels[0] - truth) / size).max())
    # Rounding of some 10 000 steps and of the reference leaves a few 1e-12 of each quantity's size.
    assert error < 1e-11, f"relative to each quantity's largest: {error:.2e}"


def test_commands_stay_within_the_inverters_circle_and_go_without_power(arm: Path) -> None:
    plant = Plant(load_scene(arm))
    rng = np.random.default_rng(12)
    for _ in range(20):
        ud, uq = rng.uniform(-2.0, 2.0, (2, 3)) * AMPLITUDE
        plant.exchange(uq, command_d=ud)
        d = np.clip(ud, -AMPLITUDE, AMPLITUDE)
        rest = np.sqrt(np.maximum(0.0, AMPLITUDE**2 - d**2))
        # The inverter's amplitude is rounded.
        expected = np.clip(uq, -rest, rest)
        assert plant.measured.applied == pytest.approx(expected, abs=1e-6 * AMPLITUDE), (
            "uq that is left"
        )
    saved, row = plant.save(), np.full(3, 3.0)
    restored = Plant(plant.scene)
    restored.restore(saved)
    for machine in (plant, restored):
        machine.advance(row, 20)
    assert plant.save() == restored.save(), "the held ud is part of what is saved"
    plant.powered = restored.powered = False
    for _ in range(20):
        plant.exchange(row, command_d=row)
        restored.exchange(0.0 * row, command_d=0.0 * row)
    assert plant.measured.applied.tolist() == [0.0, 0.0, 0.0], "uq without power"
    np.testing.assert_array_equal(state_of(plant), state_of(restored), "ud without power")
    with pytest.raises(Refusal, match=r"command_d must be finite"):
        plant.exchange(row, command_d=[0.0, math.nan, 0.0])
