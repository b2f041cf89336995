"""Cogging of motors against the pendulum's closed form, and its energy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines import GANTRY, gantry_urdf, write_scene
from scipy.special import ellipj

from emulator_node.fleet import Fleet
from emulator_node.plant import Plant
from emulator_node.scene import load_scene
from words.refusal import Refusal

MOVED = np.array([6.0, 4.0, 2.0])  # kg, by each joint
RATIO, ROTOR = 0.01, 1e-4
FREE = {"kind": "torque", "rotor_inertia": ROTOR}
DC = {
    "resistance": 1.0, "inductance": 1e-3, "torque_constant": 0.05, "back_emf_constant": 0.05,
    "rotor_inertia": ROTOR,
}  # fmt: skip
ELASTIC = {"ratio": RATIO, "stiffness": 2e4, "damping": 20.0}


def gantry(folder: Path, motor: dict[str, Any], gear: dict[str, Any], waves: list[Any]) -> Path:
    joints = {
        name: {"motor": {**motor, "cogging": {"waves": own}}, "gear": gear}
        for name, own in zip(GANTRY, waves, strict=True)
    }
    integrator = {"scheme": "rosenbrock", "dt": 1e-4}
    return write_scene(folder, gantry_urdf(), joints, energy_flow=True, integrator=integrator)


def test_a_free_rotor_swings_in_a_tooth_as_a_pendulum(tmp_path: Path) -> None:
    """J d2tm/dt2 = -a sin(k tm): sin(k tm / 2) = m sn(W t, m^2), W^2 = k a / J, to order 2."""
    rng = np.random.default_rng(21)
    k, a = rng.integers(6, 40, 3).astype(float), rng.uniform(0.01, 0.05, 3)
    file = gantry(
        tmp_path,
        FREE,
        {"ratio": RATIO},
        [[list(one)] for one in zip(k.tolist(), a.tolist(), strict=True)],
    )
    W, m = np.sqrt(k * a / (ROTOR + MOVED * RATIO**2)), np.array([0.2, 0.6, 0.95])
    errors = []
    for dt in (1e-4, 5e-5):
        plant, off = Plant(load_scene(file, {"integrator.dt": dt})), []
        plant.reset(np.zeros(3), RATIO * 2.0 * m * W / k)
        for _ in range(30):
            plant.advance(np.zeros(3), round(0.01 / dt))
            sn = ellipj(W * plant.t, m**2)[0]
            off.append(np.abs(plant.state.theta_m - 2.0 / k * np.arcsin(m * sn)) * k)
        errors.append(float(np.max(off)))
    # Of the phase k tm; a quarter at half the step, but for the error's next term.
    assert errors[1] < 2e-3 and errors[1] < 0.3 * errors[0], f"{errors}"


def test_energy_is_conserved_with_waves_of_any_kind(tmp_path: Path) -> None:
    rng = np.random.default_rng(22)
    waves = [
        [[float(rng.integers(2, 40)), float(rng.normal(0.0, 0.02)), float(rng.uniform(-3, 3))]
         for _ in range(count)]
        for count in (1, 2, 4)
    ]  # fmt: skip
    file = gantry(tmp_path, DC, ELASTIC, waves)
    rows, left = rng.uniform(-20.0, 20.0, (8, 3)), []
    for dt in (1e-4, 5e-5):
        plant = Plant(load_scene(file, {"integrator.dt": dt}))
        before, given, dissipated = plant.energy, 0.0, 0.0
        for row in rows:
            flow = plant.advance_metered(row, round(0.02 / dt))
            given += float(flow.given.sum())
            dissipated += float(flow.dissipated.sum())
        left.append(abs(plant.energy - before - given + dissipated) / (abs(given) + dissipated))
    # What is left is the scheme's error, of order 2.
    assert left[1] < 1e-4 and left[1] < 0.35 * left[0], f"{left}"
    scene, many = load_scene(file), rng.uniform(-20.0, 20.0, (10, 9, 3))
    q = Fleet(scene, 9).run(many, 50)
    for k in range(9):
        # Lanes differ from one machine by rounding.
        one = Plant(scene).run(many[:, k], 50)
        assert q[:, k] == pytest.approx(one, rel=1e-9, abs=1e-12), f"arm {k}"


BAD: list[tuple[object, str]] = [
    (3.0, "must be a list"),
    ([1.0, 2.0], "must list waves of [order, amplitude in N m]"),
    ([[1.0]], "must list waves of [order, amplitude in N m]"),
    ([[0.0, 1.0]], "must have waves of orders > 0"),
    ([[float("nan"), 1.0]], "must list waves of numbers"),
    ([[6.0, "much"]], "must list waves of numbers"),
    ([[6.0, True]], "must list waves of numbers"),
    ([[6.0, 0.1]] * 17, "must have at most 16 waves"),
]


@pytest.mark.parametrize(("waves", "words"), BAD, ids=lambda value: str(value)[:30])
def test_bad_waves_are_refused_in_one_line(waves: object, words: str) -> None:
    with pytest.raises(Refusal) as refusal:
        load_scene("three_axis", {"joints.elbow.motor.cogging": {"waves": waves}})
    said = str(refusal.value)
    assert said.startswith("three_axis.yaml: joints.elbow.motor.cogging.waves ") and words in said
    assert "\n" not in said
