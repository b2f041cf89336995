"""The plant as an object: resets, bits, refusals, divergence."""

import numpy as np
import pytest

from arm_emulator import Diverged, Plant, load_scene
from arm_emulator.machine.schemes.known import SCHEMES


@pytest.fixture(params=SCHEMES)
def plant(request: pytest.FixtureRequest) -> Plant:
    """A machine of `test_schemes`, whose libraries it shares."""
    overrides = {"varied": ["joints.*"], "integrator.scheme": request.param, "integrator.dt": 1e-4}
    return Plant(load_scene("three_axis", overrides=overrides))


def as_bytes(plant: Plant) -> bytes:
    state = plant.state
    arrays = (state.current, state.theta_m, state.omega_m, state.q, state.v, state.gear_torque)
    return b"".join(array.tobytes() for array in arrays)


def test_reset_puts_motors_along_with_the_links(plant: Plant) -> None:
    q, v = np.array([0.1, -0.2, 0.3]), np.array([1.0, 2.0, -3.0])
    plant.advance([5.0, 5.0, 5.0], 10)
    plant.reset(q, v)
    state = plant.state
    assert state.t == 0.0
    assert np.array_equal(state.q, q) and np.array_equal(state.v, v)
    assert np.array_equal(state.current, np.zeros(3))
    # theta_m = q / Ng and back: two roundings at Kg = 1e4.
    assert state.gear_torque == pytest.approx(np.zeros(3), abs=1e4 * 1e-15)
    assert state.omega_m == pytest.approx(v / 0.01, rel=1e-15)


def test_same_bits_however_the_steps_are_divided(plant: Plant) -> None:
    voltage = [3.0, -20.0, 7.0]
    plant.advance(voltage, 1000)
    at_once = as_bytes(plant)
    for pieces in ([1] * 1000, [17] * 58 + [14], [999, 1], [0, 500, 500]):
        plant.reset()
        for count in pieces:
            plant.advance(voltage, count)
        assert as_bytes(plant) == at_once
        assert plant.t == 1000 * 1e-4


@pytest.mark.parametrize("steps", [0, 1, 3, 16, 50])
def test_same_bits_in_rows_as_in_single_calls(plant: Plant, steps: int) -> None:
    rows = np.random.default_rng(1).uniform(-60.0, 60.0, (40, 3))  # beyond the supply, too
    positions = []
    for row in rows:
        plant.advance(row, steps)
        positions.append(plant.state.q)
    end = as_bytes(plant)
    plant.reset()
    assert plant.run(rows, steps).tobytes() == np.array(positions).tobytes()
    assert as_bytes(plant) == end


def test_divergence_is_caught_at_the_last_state_within_bounds() -> None:
    """Scheme `paper` cannot hold three_axis at 10 ms."""
    overrides = {
        "integrator.scheme": "paper",
        "integrator.dt": 1e-2,
        "servo_period": 1e-2,
    }
    plant = Plant(load_scene("three_axis", overrides=overrides))
    with pytest.raises(Diverged, match=r"joint (waist|shoulder|elbow) diverged after t = .* at dt"):
        plant.advance([20.0, -20.0, 10.0], 100_000)
    last = plant.state
    assert plant.t < 10.0
    measured = np.floor(last.theta_m * 1024 / (2.0 * np.pi))
    np.testing.assert_array_equal(plant.measured.encoder_counts, measured, "measured there")
    np.testing.assert_array_equal(plant.measured.current, last.current, "measured there")
    for array in (last.q, last.v, last.current, last.theta_m, last.omega_m):
        assert np.isfinite(array).all()
    assert np.abs(last.v).max() * 1e-2 <= np.pi
    with pytest.raises(Diverged):  # it stays there
        plant.advance([20.0, -20.0, 10.0], 1)
    assert plant.t == last.t
    plant.reset()
    plant.advance([0.0, 0.0, 0.0], 10)


@pytest.mark.parametrize("steps", [1, 3, 40])
def test_divergence_within_rows_is_that_of_single_calls(steps: int) -> None:
    overrides = {"integrator.scheme": "paper", "integrator.dt": 1e-2, "servo_period": 1e-2}
    plant = Plant(load_scene("three_axis", overrides=overrides))
    rows = np.random.default_rng(2).uniform(-20.0, 20.0, (1000, 3))
    with pytest.raises(Diverged):
        for row in rows:
            plant.advance(row, steps)
    t, end = plant.t, as_bytes(plant)
    plant.reset()
    with pytest.raises(Diverged):
        plant.run(rows, steps)
    assert plant.t == t and as_bytes(plant) == end
