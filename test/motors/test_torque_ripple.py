"""Torque ripple of motors against the integral of its work."""

from pathlib import Path

import numpy as np
import pytest
from draws import with_slow
from machines import MOVED, ROTOR, gantry_urdf, write_scene

from arm_emulator import Plant, Refusal, load_scene

RATIO = 0.01


@pytest.fixture(scope="module")
def gantry(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[list[float]]]:
    """A torque behind a rigid gear at x, and its waves."""
    rng = np.random.default_rng(31)
    waves = [
        [float(rng.integers(2, 40)), float(rng.uniform(-0.2, 0.2)), float(rng.uniform(-3, 3))]
        for _ in range(3)
    ]
    motor = {"kind": "torque", "rotor_inertia": ROTOR, "ripple": {"waves": waves}}
    joints = {"x": {"motor": motor, "gear": {"ratio": RATIO}}, "y": {}, "z": {}}
    folder, integrator = tmp_path_factory.mktemp("gantry"), {"scheme": "rosenbrock", "dt": 1e-4}
    return write_scene(folder, gantry_urdf(), joints, integrator=integrator), waves


@pytest.mark.parametrize("u", with_slow([0.05, -0.03], 1))
def test_a_constant_torque_does_the_work_of_its_waves(
    gantry: tuple[Path, list[list[float]]], u: float
) -> None:
    """J wm^2 / 2 = u (tm - sum a/k (cos(k tm + phi) - cos phi)) behind a rigid gear."""
    (file, waves), errors = gantry, []
    for dt in (1e-4, 5e-5):
        plant, off = Plant(load_scene(file, {"integrator.dt": dt})), []
        for _ in range(30):
            plant.advance([u, 0.0, 0.0], round(0.01 / dt))
            tm, wm = plant.state.theta_m[0], plant.state.omega_m[0]
            s = sum(a / k * (np.cos(k * tm + phi) - np.cos(phi)) for k, a, phi in waves)
            kinetic = 0.5 * (ROTOR + MOVED[0] * RATIO**2) * wm**2
            off.append(abs(kinetic / (u * (tm - s)) - 1.0))
        errors.append(float(np.max(off[5:])))
    # A quarter at half the step, but for the error's next term.
    assert errors[1] < 1e-3 and errors[1] < 0.3 * errors[0], f"{errors}"


@pytest.mark.parametrize(
    ("waves", "inductance", "rule"),
    [
        ([[6.0, 0.5], [12.0, -0.6]], {},
         r"ripple\.waves must have amplitudes that sum up to at most 0\.9, got 1\.1"),
        ([[6.0, 0.1]], {"joints.elbow.motor.inductance": None},
         "ripple must come with an inductance"),
    ],
)  # fmt: skip
def test_impossible_ripple_is_refused(
    waves: list[list[float]], inductance: dict[str, None], rule: str
) -> None:
    with pytest.raises(Refusal, match=rf"elbow\.motor\.{rule}"):
        load_scene("three_axis", {"joints.elbow.motor.ripple": {"waves": waves}, **inductance})
