"""Torque ripple of motors against the integral of its work, and its energy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines import GANTRY, gantry_urdf, write_scene

from emulator_node.fleet import Fleet
from emulator_node.plant import Plant
from emulator_node.scene import load_scene
from words.refusal import Refusal

MOVED = np.array([6.0, 4.0, 2.0])  # kg, by each joint
RATIO, ROTOR = 0.01, 1e-4
INTEGRATOR = {"scheme": "rosenbrock", "dt": 1e-4}
ELASTIC = {"ratio": RATIO, "stiffness": 2e4, "damping": 20.0}
DC = {
    "resistance": 1.0, "inductance": 1e-3, "torque_constant": 0.05, "back_emf_constant": 0.05,
    "rotor_inertia": ROTOR,
}  # fmt: skip
PMSM = {
    "kind": "pmsm", "resistance": 0.5, "inductance_d": 1e-3, "inductance_q": 2e-3, "flux": 0.01,
    "pole_pairs": 4, "rotor_inertia": ROTOR,
}  # fmt: skip


def drawn_waves(rng: np.random.Generator, count: int) -> dict[str, Any]:
    waves = [
        [float(rng.integers(2, 40)), float(rng.uniform(-0.2, 0.2)), float(rng.uniform(-3, 3))]
        for _ in range(count)
    ]
    return {"ripple": {"waves": waves}}


def test_a_constant_torque_does_the_work_of_its_waves(tmp_path: Path) -> None:
    """J wm^2 / 2 = u (tm - sum a/k (cos(k tm + phi) - cos phi)) behind a rigid gear."""
    rng = np.random.default_rng(31)
    waves = [drawn_waves(rng, count) for count in (1, 2, 3)]
    joints = {
        name: {"motor": {"kind": "torque", "rotor_inertia": ROTOR, **own}, "gear": {"ratio": RATIO}}
        for name, own in zip(GANTRY, waves, strict=True)
    }
    file = write_scene(tmp_path, gantry_urdf(), joints, integrator=INTEGRATOR)
    u, errors = np.array([0.05, 0.08, -0.03]), []
    for dt in (1e-4, 5e-5):
        plant, off = Plant(load_scene(file, {"integrator.dt": dt})), []
        for _ in range(30):
            plant.advance(u, round(0.01 / dt))
            tm, wm = plant.state.theta_m, plant.state.omega_m
            s = [
                sum(a / k * (np.cos(k * angle + phi) - np.cos(phi)) for k, a, phi in own)
                for own, angle in zip((w["ripple"]["waves"] for w in waves), tm, strict=True)
            ]
            kinetic = 0.5 * (ROTOR + MOVED * RATIO**2) * wm**2
            off.append(np.abs(kinetic / (u * (tm - s)) - 1.0))
        errors.append(float(np.max(off[5:])))
    # A quarter at half the step, but for the error's next term.
    assert errors[1] < 1e-3 and errors[1] < 0.3 * errors[0], f"{errors}"


def test_energy_is_conserved_in_motors_of_any_kind(tmp_path: Path) -> None:
    rng = np.random.default_rng(32)
    motors = [DC, {**DC, "current_limit": 30.0}, PMSM]
    joints = {
        name: {"motor": {**motor, **drawn_waves(rng, 2)}, "gear": ELASTIC}
        for name, motor in zip(GANTRY, motors, strict=True)
    }
    file = write_scene(tmp_path, gantry_urdf(), joints, energy_flow=True, integrator=INTEGRATOR)
    rows, left = rng.uniform(-7.0, 7.0, (8, 3)), []
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


def test_ripple_that_turns_the_torque_about_is_refused() -> None:
    waves = {"joints.elbow.motor.ripple": {"waves": [[6.0, 0.5], [12.0, -0.6]]}}
    words = r"ripple\.waves must have amplitudes that sum up to at most 0\.9, got 1\.1"
    with pytest.raises(Refusal, match=words):
        load_scene("three_axis", waves)


def test_ripple_without_an_inductance_is_refused() -> None:
    ripple = {"joints.elbow.motor.ripple": {"waves": [[6.0, 0.1]]}}
    with pytest.raises(Refusal, match=r"elbow\.motor\.ripple must come with an inductance"):
        load_scene("three_axis", {**ripple, "joints.elbow.motor.inductance": None})
