"""Analog sensors of joints: what each kind reads, with its errors, against the truth."""

from typing import Any

import numpy as np
import pytest

from arm_emulator import Plant, Refusal, load_scene
from arm_emulator.machine.parts.measuring.sensors import ANALOG
from oracles.part_truths import get_truth

TICKS = 2000
GAIN, STEPS, NOISE, DELAY = 0.02, 2**10, 0.02, 2


# The truth of each kind, by its section.
KINDS = {kind.section: get_truth(kind) for kind in ANALOG if kind.field == "reading"}
WINDING = {"heat_capacity": 0.2, "thermal_resistance": 2.0, "ambient": 30.0}
RIGID = {"joints.elbow.gear.stiffness": None, "joints.elbow.gear.damping": None}

CURRENT: dict[str, Any] = {"joints.elbow.current_sensor": {"noise": 0.1}}


def sensors() -> dict[str, Any]:
    """Overrides: all kinds at the waist and at the elbow, none at the shoulder."""
    overrides: dict[str, Any] = {
        f"joints.{name}.motor.winding": WINDING for name in ("waist", "elbow")
    }
    for name, kind in KINDS.items():
        size = kind.EXCEEDED
        scaled = {"offset": -0.2 * size, "range": size, "resolution": size / STEPS}
        overrides[f"joints.waist.{name}"] = {"gain_error": GAIN, **scaled}
        overrides[f"joints.elbow.{name}"] = {"noise": NOISE * size, "delay": DELAY}
    return overrides


@pytest.fixture(scope="module")
def rows() -> dict[str, np.ndarray]:
    """Readings and truths by name, a row per tick, under commands that jump."""
    scene = load_scene("three_axis", RIGID | CURRENT | sensors())
    plant, rng = Plant(scene), np.random.default_rng(4)
    columns: dict[str, list[np.ndarray]] = {}
    for tick in range(TICKS):
        if tick % 100 == 0:
            command = rng.uniform(-30.0, 30.0, 3)
        for name, kind in KINDS.items():
            (reading,) = kind.OUTPUTS
            columns.setdefault(name, []).append(np.array(getattr(plant.measured, reading)))
            columns.setdefault(f"true {name}", []).append(np.array(kind.measure(plant)))
        plant.exchange(command)
    return {name: np.array(row) for name, row in columns.items()}


@pytest.mark.parametrize("name", KINDS)
def test_it_shows_its_quantity_with_its_errors(rows: dict[str, np.ndarray], name: str) -> None:
    reading, true, size = rows[name][:, 0], rows[f"true {name}"][:, 0], KINDS[name].EXCEEDED
    expected = np.clip((1.0 + GAIN) * true - 0.2 * size, -size, size)
    error = np.abs(reading - expected).max() * STEPS / size
    assert 0.4 < error <= 0.5 * (1.0 + 1e-9), "half a multiple of its resolution, from tick 0 on"
    at_end = np.abs(expected) == size
    assert at_end.any() and not at_end.all(), "its range was reached"
    assert not rows[name][:, 1].any(), "a joint without one"


@pytest.mark.parametrize("name", KINDS)
def test_its_noise_is_white_and_it_is_late(rows: dict[str, np.ndarray], name: str) -> None:
    reading, true = rows[name][:, 2], rows[f"true {name}"][:, 2]
    noise = (reading[DELAY:] - true[:-DELAY]) / (NOISE * KINDS[name].EXCEEDED)
    count = len(noise)
    # Five standard deviations of each statistic.
    assert abs(noise.mean()) < 5 / np.sqrt(count)
    assert noise.std() == pytest.approx(1.0, rel=5 / np.sqrt(2 * count))
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 5 / np.sqrt(count)


def test_a_sensor_without_its_quantity_is_refused() -> None:
    bare = {"joints.elbow.motor": None, "joints.elbow.gear": None, "joints.elbow.encoder": None}
    for overrides, line in (
        (bare | {"joints.elbow.motor_tachometer": {}}, "motor_tachometer must .* a motor"),
        ({"joints.waist.thermometer": {}}, "thermometer must .* a motor with a winding, got no"),
    ):
        with pytest.raises(Refusal, match=line):
            load_scene("three_axis", overrides)
