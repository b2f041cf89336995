"""Unknowns of one's own, fitted to records of machines whose numbers are known."""

from collections.abc import Mapping

import numpy as np
import pytest
from test_assumed import VARIED

from arm_emulator import Plant, Refusal, Scene, load_scene
from arm_emulator_identification.fit_numbers import Sought, fit_numbers

TRUTH = {"magnets": 0.93, "belts": 0.8}
UNKNOWNS = {name: Sought(1.0, 0.2, 0.3, 2.0) for name in TRUTH}
JOINTS = "waist", "shoulder", "elbow"
TICKS = 300


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("three_axis", {"varied": VARIED})


def modified(scene: Scene, values: Mapping[str, float]) -> dict[str, float]:
    """Weaker magnets lower both constants of all motors alike; belts are the gears' stiffness."""
    of = {"torque_constant": "magnets", "back_emf_constant": "magnets", "stiffness": "belts"}
    nominal = {number.name: number.value for number in scene.varied}
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


@pytest.mark.slow
def test_shares_of_many_numbers_are_estimated(scene: Scene) -> None:
    rows, angles = record(scene)
    fitted = fit_numbers(
        scene, rows, {"theta_m": angles}, UNKNOWNS, lambda values: modified(scene, values)
    )
    for name, true in TRUTH.items():
        error = fitted.values[name] - true
        assert abs(error) < 0.01 * true, (name, fitted)
        assert abs(error) < 5.0 * fitted.deviations[name] + 1e-4, (name, fitted)
    assert fitted.numbers == modified(scene, fitted.values)
    count = 2.0 * np.pi / scene.joints[0].counts_per_turn
    assert fitted.errors["theta_m"] == pytest.approx(count / np.sqrt(12.0), rel=0.1), "half a count"


def test_without_a_modifier_the_unknowns_are_numbers_of_the_scene(scene: Scene) -> None:
    rows, angles = record(scene)
    nominal = {number.name: number.value for number in scene.varied}
    unknowns = {name: Sought(value, 0.2 * value) for name, value in nominal.items()}
    fitted = fit_numbers(scene, rows, {"theta_m": angles}, unknowns)
    for name, true in modified(scene, TRUTH).items():
        if not name.endswith("stiffness"):  # each by itself shows little in so short a record
            assert fitted.values[name] == pytest.approx(true, rel=0.03), (name, fitted)
        assert fitted.deviations[name] < 0.21 * nominal[name]


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"commands": np.zeros((5, 2))}, r"commands must have shape \(K, 3\)"),
        ({"signals": {"counts": np.zeros((5, 3))}}, "signal must be a quantity, got counts"),
        ({"signals": {"q": np.zeros((4, 3))}}, "q must have the shape of the commands"),
        ({"sought": {}}, "sought and signals must be one or more"),
        ({"sought": {"x": Sought(1.0, 0.0)}}, "x must be Sought, with a value from least to most"),
        ({"sought": {"x": Sought(1.0, 0.1)}}, "number must be one that can be varied, got x"),
        ({"sought": {"x": Sought("a", 0.1)}}, "sought x must be Sought"),
        ({"sought": {"x": Sought(np.nan, 0.1)}}, "sought x must be Sought"),
        ({"sought": {"x": 1.0}}, "sought x must be Sought"),
        ({"sought": ["x"]}, "sought and signals must be given by names"),
        ({"signals": {"q": np.full((5, 3), np.nan)}}, "q must be finite"),
        ({"modifier": lambda values: None}, "modifier must return numbers by name"),
        ({"modifier": lambda values: {}}, "modifier must return numbers by name"),
    ],
)  # fmt: skip
def test_bad_arguments_are_refused(scene: Scene, change: dict[str, object], rule: str) -> None:
    arguments = {
        "commands": np.zeros((5, 3)),
        "signals": {"q": np.zeros((5, 3))},
        "sought": UNKNOWNS,
    }
    with pytest.raises(Refusal, match=rule):
        fit_numbers(scene, **(arguments | change))


@pytest.mark.parametrize("ends", [(0.8, 0.925), (0.935, 0.936), (0.9, 1.0)])
def test_an_unknown_stays_in_its_range_however_narrow(
    scene: Scene, ends: tuple[float, float]
) -> None:
    (low, high), tried = ends, []
    rows, angles = record(scene)

    def modifier(values: Mapping[str, float]) -> dict[str, float]:
        tried.append(values["magnets"])
        return modified(scene, {**TRUTH, **values})

    unknowns = {"magnets": Sought(low, 0.2, low, high)}
    fitted = fit_numbers(scene, rows[:60], {"theta_m": angles[:60]}, unknowns, modifier)
    assert all(low <= value <= high for value in tried)
    nearest = min(max(TRUTH["magnets"], low), high)
    assert fitted.values["magnets"] == pytest.approx(nearest, abs=1e-3), "counts are coarse"
