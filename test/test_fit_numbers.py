"""Unknowns of one's own, fitted to records of machines whose numbers are known."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from arm_emulator import Plant, Refusal, Scene, Sought, fit_numbers, load_scene

TRUTH = {"magnets": 0.93, "belts": 0.8}
SOUGHT = {name: Sought(1.0, 0.2, 0.3, 2.0) for name in TRUTH}
JOINTS = "waist", "shoulder", "elbow"
NUMBERS = ("motor.torque_constant", "motor.back_emf_constant", "gear.stiffness")
# In this order, in which `test_assumed` compiles the same lanes.
VARIED = sorted(f"joints.{joint}.{name}" for joint in JOINTS for name in NUMBERS)
TICKS = 300


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("three_axis", {"varied": VARIED})


def modified(scene: Scene, values: Mapping[str, float]) -> dict[str, float]:
    """Weaker magnets lower both constants of all motors alike; belts are the gears' stiffness."""
    of = {"torque_constant": "magnets", "back_emf_constant": "magnets", "stiffness": "belts"}
    nominal = {one.name: one.value for one in scene.varied}
    return {name: values[of[name.rpartition(".")[2]]] * value for name, value in nominal.items()}


def record(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Commands, and motor angles by the encoders [rad]."""
    plant = Plant(scene)
    for name, value in modified(scene, TRUTH).items():
        plant.set_parameter(name, value)
    rng = np.random.default_rng(5)
    rows = np.repeat(rng.uniform(-25.0, 25.0, (TICKS // 20, 3)), 20, axis=0)
    counts = []
    for row in rows:
        plant.exchange(row)
        counts.append(plant.measured.encoder_counts)
    cpt = np.array([joint.counts_per_turn for joint in scene.joints])
    return rows, 2.0 * np.pi * (np.array(counts) + 0.5) / cpt


def test_shares_of_many_numbers_are_found(scene: Scene) -> None:
    rows, angles = record(scene)
    found = fit_numbers(
        scene, rows, {"theta_m": angles}, SOUGHT, lambda values: modified(scene, values)
    )
    for name, true in TRUTH.items():
        error = found.values[name] - true
        assert abs(error) < 0.01 * true, (name, found)
        assert abs(error) < 5.0 * found.deviations[name] + 1e-4, (name, found)
    assert found.numbers == modified(scene, found.values)
    count = 2.0 * np.pi / scene.joints[0].counts_per_turn
    assert found.errors["theta_m"] == pytest.approx(count / np.sqrt(12.0), rel=0.1), "half a count"


def test_without_a_modifier_the_unknowns_are_numbers_of_the_scene(scene: Scene) -> None:
    rows, angles = record(scene)
    nominal = {one.name: one.value for one in scene.varied}
    sought = {name: Sought(value, 0.2 * value) for name, value in nominal.items()}
    found = fit_numbers(scene, rows, {"theta_m": angles}, sought)
    for name, true in modified(scene, TRUTH).items():
        if not name.endswith("stiffness"):  # each by itself shows little in so short a record
            assert found.values[name] == pytest.approx(true, rel=0.03), (name, found)
        assert found.deviations[name] < 0.21 * nominal[name]


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"commands": np.zeros((5, 2))}, r"commands must have shape \(K, 3\)"),
        ({"signals": {"counts": np.zeros((5, 3))}}, "signal must be a quantity, got counts"),
        ({"signals": {"q": np.zeros((4, 3))}}, "q must have the shape of the commands"),
        ({"sought": {}}, "sought and signals must be one or more"),
        ({"sought": {"x": Sought(1.0, 0.0)}}, "must have a value from least to most, and a width"),
        ({"sought": {"x": Sought(1.0, 0.1)}}, "number must be one that can be varied, got x"),
    ],
)  # fmt: skip
def test_bad_arguments_are_refused(scene: Scene, change: dict[str, object], rule: str) -> None:
    given = {"commands": np.zeros((5, 3)), "signals": {"q": np.zeros((5, 3))}, "sought": SOUGHT}
    with pytest.raises(Refusal, match=rule):
        fit_numbers(scene, **(given | change))
