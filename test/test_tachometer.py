"""Tachometers at links, against the true speed."""

from __future__ import annotations

import numpy as np
import pytest
from sensor_motion import readings_and_truth

from arm_emulator import Plant, Scene, load_scene

TICKS = 2000


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Two joints that have one, of which one is noisy and late, and one that has none."""
    sensors = {
        "joints.waist.tachometer": {"gain_error": 0.02, "offset": -0.3, "range": 1.5},
        "joints.elbow.tachometer": {"noise": 0.05, "delay": 2},
    }
    return load_scene("three_axis", sensors)


@pytest.fixture(scope="module")
def run(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Speeds measured and true, a row per tick."""
    return readings_and_truth(
        Plant(scene), lambda one: (one.measured.link_speed, one.state.v), TICKS, 30.0, seed=4
    )


def test_it_shows_the_speed_with_its_errors(run: tuple[np.ndarray, np.ndarray]) -> None:
    shown, true = run
    expected = np.clip(1.02 * true[:, 0] - 0.3, -1.5, 1.5)
    np.testing.assert_allclose(shown[:, 0], expected, rtol=1e-12, atol=1e-12)
    assert (np.abs(shown[:, 0]) == 1.5).any(), "its range was reached"
    assert not shown[:, 1].any(), "a joint without one"


def test_its_noise_is_white_and_its_delay_two_ticks(run: tuple[np.ndarray, np.ndarray]) -> None:
    shown, true = run
    noise = shown[2:, 2] - true[:-2, 2]
    count = len(noise)
    # Five standard deviations of each statistic.
    assert abs(noise.mean()) < 5 * 0.05 / np.sqrt(count)
    assert noise.std() == pytest.approx(0.05, rel=5 / np.sqrt(2 * count))
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 5 / np.sqrt(count)
    undelayed = shown[2:, 2] - true[2:, 2]
    assert undelayed.std() > 1.2 * noise.std(), "the delay is seen"


def test_other_sensors_have_the_same_bits_beside_it(scene: Scene) -> None:
    """Neither the motion nor the noise of another sensor changes."""
    other = {"joints.elbow.current_sensor": {"noise": 0.1}}
    beside = {"joints.elbow.tachometer": {"noise": 0.05}}
    rows = []
    for sensors in (other, other | beside):
        plant = Plant(load_scene("three_axis", sensors))
        for _ in range(100):
            plant.exchange(np.array([5.0, -4.0, 3.0]))
        rows.append((plant.measured.current.tobytes(), plant.state.q.tobytes()))
    assert rows[0] == rows[1]
