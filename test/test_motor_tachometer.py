"""Tachometers at motors, against the true speed of the shafts behind elastic and rigid gears."""

from __future__ import annotations

import numpy as np
import pytest

from arm_emulator import Plant, Refusal, load_scene

TICKS = 500
SENSORS = {
    "joints.waist.motor_tachometer": {"gain_error": 0.02, "offset": -3.0, "range": 120.0},
    "joints.shoulder.motor_tachometer": {"delay": 2},
    "joints.elbow.motor_tachometer": {"resolution": 0.5},
    "joints.elbow.gear.stiffness": None,  # rigid: the speed is the link's by the ratio
    "joints.elbow.gear.damping": None,
}


@pytest.fixture(scope="module")
def run() -> dict[str, np.ndarray]:
    """Speeds measured, of the motors and of the links, a row per tick."""
    plant, rng = Plant(load_scene("three_axis", SENSORS)), np.random.default_rng(4)
    rows: dict[str, list[np.ndarray]] = {"shown": [], "motor": [], "link": []}
    for tick in range(TICKS):
        if tick % 50 == 0:
            command = rng.uniform(-40.0, 40.0, 3)
        plant.exchange(command)
        state = plant.state
        values = (plant.measured.motor_speed, state.omega_m, state.v)
        for row, value in zip(rows.values(), values, strict=True):
            row.append(value)
    return {name: np.array(row) for name, row in rows.items()}


def test_it_shows_the_speed_of_the_shaft_with_its_errors(run: dict[str, np.ndarray]) -> None:
    expected = np.clip(1.02 * run["motor"][:, 0] - 3.0, -120.0, 120.0)
    np.testing.assert_allclose(run["shown"][:, 0], expected, rtol=1e-12, atol=1e-12)
    assert (np.abs(expected) == 120.0).any() and (np.abs(expected) < 120.0).any(), "its range"


def test_it_is_late_by_its_delay_and_follows_the_rotor_not_the_link(
    run: dict[str, np.ndarray],
) -> None:
    shown, ratio = run["shown"][2:, 1], load_scene("three_axis").gear_ratios[1]
    np.testing.assert_array_equal(shown, run["motor"][:-2, 1])
    assert np.abs(shown - run["link"][:-2, 1] / ratio).max() > 0.1, "the gear winds up [rad/s]"


def test_behind_a_rigid_gear_it_is_the_speed_of_the_link_by_the_ratio(
    run: dict[str, np.ndarray],
) -> None:
    ratio = load_scene("three_axis").gear_ratios[2]
    error = run["shown"][:, 2] - run["link"][:, 2] / ratio
    assert 0.2 < np.abs(error).max() <= 0.25 * (1.0 + 1e-9), "half of its resolution [rad/s]"


def test_a_joint_without_a_motor_is_refused_one() -> None:
    bare = {"joints.elbow.motor": None, "joints.elbow.gear": None, "joints.elbow.encoder": None}
    with pytest.raises(Refusal, match="motor_tachometer must belong to a joint with a motor"):
        load_scene("three_axis", bare | {"joints.elbow.motor_tachometer": {"noise": 0.1}})
