"""Cogging of motors against the pendulum's closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from machines import GANTRY, MOVED, ROTOR, gantry_urdf, write_scene
from scipy.special import ellipj

from arm_emulator import Plant, Refusal, load_scene

RATIO, ORDERS = 0.01, (17.0, 23.0, 31.0)
FREE = {"kind": "torque", "rotor_inertia": ROTOR}


@pytest.fixture(scope="module")
def gantry(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    """Rotors that nothing holds but one tooth each, and its amplitudes."""
    a = np.random.default_rng(22).uniform(0.01, 0.05, 3)
    joints = {
        name: {
            "motor": FREE | {"cogging": {"waves": [[k, float(amplitude)]]}},
            "gear": {"ratio": RATIO},
        }
        for name, k, amplitude in zip(GANTRY, ORDERS, a, strict=True)
    }
    folder, integrator = tmp_path_factory.mktemp("gantry"), {"scheme": "rosenbrock", "dt": 1e-4}
    return write_scene(folder, gantry_urdf(), joints, integrator=integrator), a


@pytest.mark.parametrize("m", [(0.2, 0.7, 0.95), (0.95, 0.4, 0.6)])
def test_a_free_rotor_swings_in_a_tooth_as_a_pendulum(
    gantry: tuple[Path, np.ndarray], m: tuple[float, float, float]
) -> None:
    """J d2tm/dt2 = -a sin(k tm): sin(k tm / 2) = m sn(W t, m^2), W^2 = k a / J, to order 2."""
    (file, a), k, modulus = gantry, np.array(ORDERS), np.array(m)
    W, errors = np.sqrt(k * a / (ROTOR + MOVED * RATIO**2)), []
    for dt in (1e-4, 5e-5):
        plant, off = Plant(load_scene(file, {"integrator.dt": dt})), []
        plant.reset(np.zeros(3), RATIO * 2.0 * modulus * W / k)
        for _ in range(30):
            plant.advance(np.zeros(3), round(0.01 / dt))
            sn = ellipj(W * plant.t, modulus**2)[0]
            truth = 2.0 / k * np.arcsin(modulus * sn)
            off.append(np.abs(plant.state.theta_m - truth) * k)
        errors.append(float(np.max(off)))
    # Of the phase k tm; a quarter at half the step, but for the error's next term.
    assert errors[1] < 2e-3 and errors[1] < 0.3 * errors[0], f"{errors}"


# What any waves may be is in test_kinematic_error.py.
BAD: list[tuple[object, str]] = [
    ([[1.0]], "must list waves of [order, amplitude in N m]"),
    ([[6.0, 1001.0]], "must list waves whose amplitude is a number within +-1000 N m"),
]


@pytest.mark.parametrize(("waves", "words"), BAD, ids=lambda value: str(value)[:30])
def test_bad_waves_are_refused_in_a_line(waves: object, words: str) -> None:
    with pytest.raises(Refusal) as refusal:
        load_scene("three_axis", {"joints.elbow.motor.cogging": {"waves": waves}})
    printed = str(refusal.value)
    assert (
        printed.startswith("three_axis.yaml: joints.elbow.motor.cogging.waves ")
        and words in printed
    )
    assert "\n" not in printed
