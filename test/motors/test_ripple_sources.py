"""An arm at constant speed shakes at the orders of its motor and gear, by its linear response."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import with_slow
from machines import LINK_INERTIA, make_link_urdf, write_scene

from arm_emulator import Plant, load_scene
from arm_emulator.base.arrays import Array

# Orders per turn: of the motor its torque ripple, its cogging, the wave generator of its gear, the
# teeth of that; of the link an eccentric wheel.
RIPPLE, COGGING, WAVE_GENERATOR, TEETH, ECCENTRIC = 6.0, 10.0, 2.0, 50.0, 1.0
ROTOR, STIFFNESS, DAMPING, VISCOUS, TORQUE = 2e-4, 900.0, 1.5, 2.0, 0.2
PERIOD = 1e-3


def draw_joint(rng: np.random.Generator) -> dict[str, Any]:
    """Small waves of all sources at once: their responses add up."""
    ratio = float(rng.uniform(0.04, 0.06))

    def wave(order: float, size: float) -> list[float]:
        return [order, size * float(rng.uniform(0.5, 1.0)), float(rng.uniform(0.0, 6.0))]

    return {
        "motor": {
            "kind": "torque",
            "rotor_inertia": ROTOR,
            "ripple": {"waves": [wave(RIPPLE, 2e-3)]},
            "cogging": {"waves": [wave(COGGING, 4e-4)]},
        },
        "gear": {
            "ratio": ratio,
            "stiffness": STIFFNESS,
            "damping": DAMPING,
            "kinematic_error": {
                "motor": [wave(WAVE_GENERATOR, 2e-5), wave(TEETH, 1e-6)],
                "link": [wave(ECCENTRIC, 1e-4)],
            },
        },
        "friction": {"viscous": VISCOUS},
    }


def respond(ratio: float, torque: tuple[complex, complex], error: complex, w: float) -> complex:
    """Speed of the link by torques on rotor and link and an error of the gear at w [rad/s].

    J tm'' = torque - Ng F,  M q'' = F - c q' + torque,  F = (K + s D) (Ng tm - q + e),  s = j w.
    """
    s, Ng = 1j * w, ratio
    spring = STIFFNESS + s * DAMPING
    table = np.array(
        [[ROTOR * s**2 + Ng**2 * spring, -Ng * spring],
         [-Ng * spring, LINK_INERTIA * s**2 + VISCOUS * s + spring]]
    )  # fmt: skip
    forces = [torque[0] - Ng * spring * error, torque[1] + spring * error]
    return complex(s * np.linalg.solve(table, forces)[1])


def fit_sines(t: Array, v: Array, frequencies: list[float]) -> Array:
    """Return mean and complex amplitudes of v = mean + sum Im(amplitude exp(j w t))."""
    columns = [np.ones_like(t)]
    for w in frequencies:
        columns += [np.sin(w * t), np.cos(w * t)]
    solution = np.linalg.lstsq(np.column_stack(columns), v, rcond=None)[0]
    return np.concatenate([[solution[0]], solution[1::2] + 1j * solution[2::2]])


@pytest.mark.parametrize("seed", with_slow(range(3), 1))
def test_every_source_shakes_the_link_by_its_order_and_the_linear_response(
    tmp_path: Path, seed: int
) -> None:
    joint = draw_joint(np.random.default_rng(seed))
    ratio = joint["gear"]["ratio"]
    varied = {"integrator": {"scheme": "rosenbrock", "dt": 2e-5}, "servo_period": PERIOD}
    plant = Plant(load_scene(write_scene(tmp_path, make_link_urdf(), {"joint": joint}, **varied)))
    plant.run(np.full((3000, 1), TORQUE), 50)  # to constant speed: time constants below 0.1 s
    rows = 16000  # 16 s, some ten turns of the link
    v, places = np.empty(rows), np.empty((rows, 2))
    for k in range(rows):
        v[k], places[k] = plant.state.v[0], (plant.state.theta_m[0], plant.state.q[0])
        plant.exchange([TORQUE])
    t = PERIOD * np.arange(rows)
    omega, *_ = np.polyfit(t, places[:, 0], 1)
    assert omega == pytest.approx(TORQUE / (VISCOUS * ratio**2), rel=1e-4), "torque by friction"
    motor, link, load = joint["motor"], omega * ratio, VISCOUS * omega * ratio
    at_motor, at_link = (places - np.outer(t, [omega, link])).mean(axis=0).tolist()
    errors = joint["gear"]["kinematic_error"]
    sources = {  # speed and angle of the shaft; wave; torques on rotor and link; error
        RIPPLE: (omega, at_motor, motor["ripple"]["waves"][0], (TORQUE, 0.0), 0.0),
        COGGING: (omega, at_motor, motor["cogging"]["waves"][0], (-1.0, 0.0), 0.0),
    }
    # An error's slope turns the load of the gear into torques: cos is j in the place of sin.
    for wave in errors["motor"]:
        sources[wave[0]] = (omega, at_motor, wave, (-1j * wave[0] * load, 0.0), 1.0)
    for wave in errors["link"]:
        sources[wave[0]] = (link, at_link, wave, (0.0, -1j * wave[0] * load), 1.0)
    frequencies = [order * speed for order, (speed, *_) in sources.items()]
    mean, *amplitudes = fit_sines(t, v, frequencies)
    assert mean.real == pytest.approx(link, rel=1e-5)
    for w, amplitude, (order, source) in zip(frequencies, amplitudes, sources.items(), strict=True):
        _, at, (_, size, phase), torques, error = source
        wave = size * np.exp(1j * (order * at + phase))
        expected = respond(ratio, (torques[0] * wave, torques[1] * wave), error * wave, w)
        # Waves ride on each other: of second order in sizes of a few thousandths.
        assert abs(amplitude - expected) < 0.02 * abs(expected), (order, amplitude, expected)
    rest = v - mean.real - sum(
        (amplitude * np.exp(1j * w * t)).imag
        for amplitude, w in zip(amplitudes, frequencies, strict=True)
    )  # fmt: skip
    largest = max(abs(amplitude) for amplitude in amplitudes)
    assert np.abs(rest).max() < 0.02 * largest, "it shakes at no other frequency"
