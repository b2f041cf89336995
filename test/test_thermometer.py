"""Thermometers in windings, against the true temperature."""

from __future__ import annotations

import numpy as np
import pytest

from arm_emulator import Plant, Refusal, load_scene

WINDING = {"heat_capacity": 0.2, "thermal_resistance": 2.0, "ambient": 30.0}
HEATED = {f"joints.{name}.motor.winding": WINDING for name in ("waist", "elbow")}


def test_it_shows_the_temperature_with_its_errors() -> None:
    sensors = {
        "joints.waist.thermometer": {"gain_error": 0.02, "offset": -1.5, "resolution": 0.5},
        "joints.elbow.thermometer": {"delay": 3},
    }
    plant = Plant(load_scene("three_axis", HEATED | sensors))
    shown, true = [plant.measured.motor_temperature], [plant.winding_temperatures]
    for _ in range(500):
        plant.exchange(np.array([8.0, 0.0, -8.0]))
        shown.append(plant.measured.motor_temperature)
        true.append(plant.winding_temperatures)
    row, T = np.array(shown), np.array(true)
    assert T[-1, 0] > 32.0 and T[-1, 2] > 32.0, "it gets warm"
    # Half a step where rounding decides.
    assert np.abs(row[:, 0] - (1.02 * T[:, 0] - 1.5)).max() <= 0.25 + 1e-9
    assert (row[:, 0] % 0.5 == 0.0).all()
    assert (row[3:, 2] == T[:-3, 2]).all(), "three periods late"
    assert not row[:, 1].any(), "a joint without one"


def test_it_needs_a_winding_that_has_a_temperature() -> None:
    line = "joints.waist.thermometer must belong to a joint with a motor with a winding, got no"
    with pytest.raises(Refusal, match=line):
        load_scene("three_axis", {"joints.waist.thermometer": {}})
