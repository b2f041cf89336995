"""Potentiometers at links, against the true position."""

from __future__ import annotations

import numpy as np
import pytest
from sensor_motion import readings_and_truth

from arm_emulator import Plant, load_scene

TICKS = 1000
RANGE, STEP, NOISE = 0.5, 2.0**-11, 0.01  # rad
SENSORS = {
    "joints.waist.potentiometer": {"range": RANGE, "resolution": STEP},
    "joints.shoulder.potentiometer": {"gain_error": 0.05, "offset": -0.1, "delay": 3},
    "joints.elbow.potentiometer": {"noise": NOISE},
}


@pytest.fixture(scope="module")
def run() -> tuple[np.ndarray, np.ndarray]:
    """Positions measured and true, a row per tick."""
    plant = Plant(load_scene("three_axis", SENSORS))
    return readings_and_truth(
        plant, lambda one: (one.measured.link_position, one.state.q), TICKS, 20.0, seed=8
    )


def test_it_has_the_position_before_anything_moves(run: tuple[np.ndarray, np.ndarray]) -> None:
    shown, true = run
    assert abs(shown[0, 0] - true[0, 0]) <= 0.5 * STEP
    assert shown[0, 1] == pytest.approx(1.05 * true[0, 1] - 0.1, rel=1e-12)


def test_it_is_limited_and_rounded(run: tuple[np.ndarray, np.ndarray]) -> None:
    shown, true = (rows[:, 0] for rows in run)
    error = shown - np.clip(true, -RANGE, RANGE)
    assert 0.4 * STEP < np.abs(error).max() <= 0.5 * STEP * (1.0 + 1e-9)
    assert (np.abs(true) > RANGE).any() and np.abs(shown).max() == RANGE


def test_it_is_late_and_has_gain_and_offset(run: tuple[np.ndarray, np.ndarray]) -> None:
    shown, true = (rows[:, 1] for rows in run)
    np.testing.assert_allclose(shown[3:], 1.05 * true[:-3] - 0.1, rtol=1e-12, atol=1e-12)
    assert np.ptp(true) > 0.1, "it moves [rad]"


def test_its_noise_is_that_of_the_scene(run: tuple[np.ndarray, np.ndarray]) -> None:
    noise = (run[0] - run[1])[:, 2]
    # Five standard deviations of each statistic.
    assert abs(noise.mean()) < 5 * NOISE / np.sqrt(TICKS)
    assert noise.std() == pytest.approx(NOISE, rel=5 / np.sqrt(2 * TICKS))
