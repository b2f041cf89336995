"""The temperature of windings against closed forms, an integration of its own, and energy."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines import DC, GANTRY, MOVED, PMSM, ROTOR, gantry_urdf, write_scene

from arm_emulator import Plant, Refusal, load_scene
from arm_emulator.machine.plant.scene_unit import write_scene_unit

RATIO = 0.01
WEAK = DC | {"back_emf_constant": 0.045}
C, RTH, AMBIENT, LIMIT = 0.05, 4.0, 35.0, 80.0
WINDING = {"heat_capacity": C, "thermal_resistance": RTH, "ambient": AMBIENT}
ALPHA, CURRENT = np.array([0.0, 0.0039, 0.0045]), np.array([5.0, 4.0, 3.5])
VOLTS = np.array([40.0, -40.0, 40.0])


@pytest.fixture(scope="module")
def locked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Links that friction holds, motors at the limit of their current; a brake at z."""
    joints: dict[str, Any] = {}
    for name, alpha, current in zip(GANTRY, ALPHA, CURRENT, strict=True):
        own = {**WINDING, "resistance_coefficient": float(alpha), "limit": LIMIT}
        joints[name] = {
            "motor": {**WEAK, "current_limit": float(current), "winding": own},
            "gear": {"ratio": RATIO},
            "friction": {"coulomb": 1e6},
        }
    joints["z"]["brake"] = {"torque": 1.0}
    folder = tmp_path_factory.mktemp("locked")
    integrator = {"scheme": "rosenbrock", "dt": 1e-3}
    return write_scene(folder, gantry_urdf(), joints, servo_period=2e-3, integrator=integrator)


def rise(t: float) -> np.ndarray:
    """C dTheta/dt = R0 (1 + alpha (ambient - 20 + Theta)) I^2 - Theta/Rth, from 0 [K]."""
    power = WEAK["resistance"] * CURRENT**2
    rate = (1.0 / RTH - ALPHA * power) / C
    final = power * (1.0 + ALPHA * (AMBIENT - 20.0)) / (C * rate)
    return final * -np.expm1(-rate * t)


@pytest.mark.slow
def test_a_constant_current_heats_along_the_exponential(locked: Path) -> None:
    errors = []
    for dt in (2e-3, 1e-3, 5e-4):
        plant, off = Plant(load_scene(locked, {"integrator.dt": dt})), []
        plant.put("test", {"current": np.sign(VOLTS) * CURRENT})
        for row in range(1, 21):
            plant.advance(VOLTS, round(0.02 / dt))
            off.append(np.abs(plant.winding_temperatures - AMBIENT - rise(0.02 * row)))
        assert plant.state.v == pytest.approx(0.0), "locked"
        errors.append(np.max(off, axis=0))
    # K; a quarter at half the step, but for the error's next term.
    assert errors[2].max() < 1e-3, f"{errors}"
    for coarse, fine in pairwise(errors):
        assert (fine < 0.27 * coarse).all(), f"{errors}"
    plant.advance(VOLTS, round(10.0 / 5e-4))
    # 50 times the time constant of the slowest: only rounding is left.
    steady = plant.winding_temperatures - AMBIENT
    assert steady == pytest.approx(rise(np.inf), rel=1e-9), "steady state"


@pytest.mark.slow
def test_a_drive_beyond_its_limit_states_so_and_is_off_until_it_is_below(locked: Path) -> None:
    scene = load_scene(locked)
    plant, restored = Plant(scene), Plant(scene)
    switched, hot = np.zeros(3, int), np.zeros(3, bool)
    for tick in range(300):
        plant.exchange(VOLTS)
        off = np.where(hot, 0.0, VOLTS)
        assert plant.measured.applied == pytest.approx(off, abs=0.0), f"command of tick {tick}"
        braked = plant.measured.brake_closed[2] != 0
        assert braked == hot[2], f"brake at tick {tick}"
        was, hot = hot, plant.winding_temperatures > LIMIT
        assert (plant.overheated == hot).all(), f"fault at tick {tick}"
        switched += was != hot
        if tick == 150:
            restored.restore(plant.save())
    assert (switched > 3).all(), f"it went off and on: {switched}"
    # The copper does not get hotter than by one period of full loss.
    assert (plant.winding_temperatures < LIMIT + 2e-3 * 25.0 * 1.3 / C).all()
    for _ in range(149):
        restored.exchange(VOLTS)
    assert (restored.winding_temperatures == plant.winding_temperatures).all(), "saved in between"
    plant.reset()
    assert (plant.winding_temperatures == AMBIENT).all(), "a reset cools"


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rigid gears, so that the equations fit on a page: dc, dc with ripple, pmsm."""
    hot = {**WINDING, "magnet_coefficient": -0.002}
    motors = [
        {**WEAK, "winding": hot},
        {**WEAK, "winding": hot, "ripple": {"waves": [[5.0, 0.2, 0.3]]}},
        {**PMSM, "winding": hot},
    ]
    joints = {
        name: {"motor": motor, "gear": {"ratio": RATIO}}
        for name, motor in zip(GANTRY, motors, strict=True)
    }
    varied = [f"joints.{name}.motor.winding.thermal_resistance" for name in GANTRY]
    folder = tmp_path_factory.mktemp("moving")
    integrator = {"scheme": "rosenbrock", "dt": 1e-4}
    return write_scene(
        folder, gantry_urdf(), joints, varied=varied, energy_flow=True, integrator=integrator
    )


def by_runge_kutta(rows: np.ndarray, seconds: float) -> np.ndarray:
    """q, v and rise of the three joints after each row, by the equations of the page."""

    def rates(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        i, i_d, tm, wm, hot = x.reshape(5, 3)
        r = 1.0 + 0.0039 * (AMBIENT - 20.0 + hot)
        m = 1.0 - 0.002 * (AMBIENT - 20.0 + hot)
        s = np.array([1.0, 1.0 + 0.2 * np.sin(5.0 * tm[1] + 0.3), 1.0])
        di = (u - r * i - 0.045 * m * s * wm) / 1e-3
        torque, loss, di_d = 0.05 * m * s * i, r * i**2, np.zeros(3)
        p, Ld, Lq, psi, R, k = 4, 1e-3, 2e-3, 0.01 * m[2], 0.5 * r[2], 2
        di_d[k] = (-R * i_d[k] + p * wm[k] * Lq * i[k]) / Ld
        di[k] = (u[k] - R * i[k] - p * wm[k] * (Ld * i_d[k] + psi)) / Lq
        torque[k] = 1.5 * p * (psi * i[k] + (Ld - Lq) * i_d[k] * i[k])
        loss[k] = 1.5 * R * (i[k] ** 2 + i_d[k] ** 2)
        return np.concatenate(
            [di, di_d, wm, torque / (ROTOR + MOVED * RATIO**2), (loss - hot / RTH) / C]
        )

    x, h, history = np.zeros(15), 2e-5, []
    for u in rows:
        for _ in range(round(seconds / h)):
            k1 = rates(x, u)
            k2 = rates(x + 0.5 * h * k1, u)
            k3 = rates(x + 0.5 * h * k2, u)
            k4 = rates(x + h * k3, u)
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        history.append(np.concatenate([RATIO * x[6:9], RATIO * x[9:12], x[12:]]))
    return np.array(history)


def test_motors_in_motion_follow_their_temperature(moving: Path) -> None:
    rows = np.random.default_rng(51).uniform(-15.0, 15.0, (6, 3))
    truth, errors = by_runge_kutta(rows, 0.02), []
    assert truth[-1, 6:].min() > 10.0, "it gets warm"
    for dt in (1e-4, 5e-5):
        plant, off = Plant(load_scene(moving, {"integrator.dt": dt})), []
        for row, expected in zip(rows, truth, strict=True):
            plant.advance(row, round(0.02 / dt))
            hot = plant.winding_temperatures - AMBIENT
            reached = np.concatenate([plant.state.q, plant.state.v, hot])
            off.append(np.abs(reached - expected) / np.abs(truth).max(axis=0))
        errors.append(np.max(off, axis=0))
    # Of the largest; a quarter at half the step, but for the error's next term.
    assert errors[1].max() < 1e-3 and (errors[1] < 0.3 * errors[0]).all(), f"{errors}"


OF_DC = "resistance", "inductance", "torque_constant", "back_emf_constant"


def test_a_scene_without_the_part_compiles_nothing_of_it() -> None:
    unit = write_scene_unit(load_scene("three_axis"))
    assert "winding.hpp" not in unit and "HeatedMotor" not in unit


@pytest.mark.parametrize(
    ("motor", "winding", "words"),
    [
        ({"inductance": None}, {}, r"elbow\.motor\.winding must come with an inductance"),
        ({}, {"limit": 20.0}, r"winding\.limit must be above the ambient, 20 degC, got 20"),
        ({"kind": "torque", **dict.fromkeys(OF_DC)}, {},
         r"elbow\.motor\.winding must belong to a motor that has a resistance, got torque"),
    ],
)  # fmt: skip
def test_senseless_arguments_are_refused(
    motor: dict[str, Any], winding: dict[str, Any], words: str
) -> None:
    own = {"heat_capacity": 10.0, "thermal_resistance": 1.0, **winding}
    changes = {f"joints.elbow.motor.{key}": value for key, value in motor.items()}
    with pytest.raises(Refusal, match=words):
        load_scene("three_axis", {**changes, "joints.elbow.motor.winding": own})
