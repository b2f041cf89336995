"""Places of joints as data of each machine: numbers of a calibration that vary."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some, with_slow
from machines import GRAVITY, Oracle, own_three_axis, write_scene
from test_calibration import displaced_urdf, draw_deltas, tool_by_pinocchio

from arm_emulator import ExternalWrench, Plant, Refusal, Scene, load_scene, sensitivities
from arm_emulator.machine.session.tool_chain import ToolChain
from arm_emulator_fleet.fleet import Fleet
from oracles.random_chain import list_moving_joints, write_random_chain, write_random_tree

Deltas = dict[str, dict[str, float]]


def name_numbers(deltas: Deltas) -> dict[str, float]:
    return {
        f"calibration.joints.{joint}.{key}": value
        for joint, delta in deltas.items()
        for key, value in delta.items()
    }


def set_all(plant: Plant, deltas: Deltas) -> None:
    for name, value in name_numbers(deltas).items():
        plant.set_parameter(name, value)


@pytest.mark.slow
@pytest.mark.parametrize("seed", with_slow(some(range(8), 3), 1))
def test_set_places_equal_pinocchio(tmp_path: Path, seed: int) -> None:
    """At the values of the scene and at others; chains, branches, turning and sliding joints."""
    rng = np.random.default_rng(seed)
    urdf = (write_random_chain, write_random_tree)[seed % 2](rng, int(rng.integers(1, 7)))
    names = list_moving_joints(urdf)
    base = draw_deltas(rng, names[:2])
    keys: dict[str, Any] = {"gravity": GRAVITY, "tool": f"{names[-1]}_link"}
    keys |= {"calibration": {"joints": base}, "varied": ["calibration.*"]}
    scene = load_scene(write_scene(tmp_path, urdf, {name: {} for name in names}, **keys))
    plant = Plant(scene)
    for deltas in (base, draw_deltas(rng, names), base | draw_deltas(rng, names[1:])):
        set_all(plant, deltas)
        expected = displaced_urdf(
            urdf, {name: dict.fromkeys("xyz", 0.0) for name in names} | deltas
        )
        oracle = Oracle(replace(scene, urdf=expected))
        values = plant.parameters
        for _ in range(5):
            q, v, tau = rng.normal(size=(3, len(names)))
            a = plant.links.accelerations(q, v, tau)
            assert a == pytest.approx(oracle.aba(q, v, tau), rel=1e-9), "condition below 1e5"
            p = ToolChain(scene, values).compute_positions(q[:, None])[:, 0]
            place = tool_by_pinocchio(expected, scene, q)
            assert p == pytest.approx(place[:3, 3], abs=1e-13), "products of ten frames"


@pytest.fixture
def deltas() -> Deltas:
    return draw_deltas(np.random.default_rng(11), ["waist", "shoulder", "elbow"])


def three_axis(folder: Path, deltas: Deltas, events: str, varied: bool) -> Scene:
    overrides: dict[str, Any] = {
        "external_wrench": True,
        "joints.*.friction.coulomb": 0.3,
        "integrator": {"scheme": "extrapolated", "dt": 5e-4, "events": events},
        "calibration": {"joints": {} if varied else deltas},
    }
    if varied:
        overrides["varied"] = ["calibration.*"]
    file = folder / "three_axis.yaml"
    return load_scene(file if file.is_file() else own_three_axis(folder, ""), overrides)


def move(plant: Plant, count: int) -> np.ndarray:
    rows = 8.0 * np.sin(0.1 * np.arange(count)[:, None] + np.arange(3.0))
    plant.set_external_wrench(plant.scene.chain.links[-1].link, ExternalWrench((3.0, -2.0, 1.0)))
    for row in rows:
        plant.exchange(row)
    return np.concatenate([plant.state.q, plant.state.v])


@pytest.mark.slow
@pytest.mark.parametrize("events", ["located", "step"])
def test_a_machine_with_set_places_moves_as_a_compiled_machine(
    tmp_path: Path, deltas: Deltas, events: str
) -> None:
    """Motors, gears, dry friction and a wrench; its saved state goes on to the bit."""
    fixed = Plant(three_axis(tmp_path, deltas, events, varied=False))
    plant = Plant(three_axis(tmp_path, deltas, events, varied=True))
    before = move(Plant(plant.scene), 100)
    set_all(plant, deltas)
    plant.reset()
    saved = plant.save()
    moved = move(plant, 100)
    # Other roundings of the same equations, over 200 steps with friction that sticks and breaks.
    assert moved == pytest.approx(move(fixed, 100), abs=1e-9)
    assert np.abs(moved - before).max() > 1e-4, "the places matter"
    assert plant.energy == pytest.approx(fixed.energy, abs=1e-8)
    plant.restore(saved)
    assert move(plant, 100).tolist() == moved.tolist()


@pytest.mark.slow
def test_lanes_have_places_of_their_own(tmp_path: Path, deltas: Deltas) -> None:
    scene = three_axis(tmp_path, deltas, "step", varied=True)
    rng = np.random.default_rng(2)
    every = [draw_deltas(rng, list(deltas)) for _ in range(9)]
    rows = [name_numbers(numbers) for numbers in every]
    fleet = Fleet(
        scene, 9, varied={name: np.array([row[name] for row in rows]) for name in rows[0]}
    )
    for k in range(60):
        fleet.exchange(np.full((9, 3), 6.0 * np.sin(0.1 * k)))
    for arm, values in enumerate(every):
        plant = Plant(scene)
        set_all(plant, values)
        plant.reset()
        for k in range(60):
            plant.exchange(np.full(3, 6.0 * np.sin(0.1 * k)))
        # Lanes round products otherwise, some 1e-16 a step.
        assert fleet.state.q[arm] == pytest.approx(plant.state.q, abs=1e-11)


@pytest.mark.slow
def test_derivatives_by_places_are_those_of_the_machine(tmp_path: Path, deltas: Deltas) -> None:
    """Beside central differences of fourth order; also at a displacement of 0."""
    scene = three_axis(tmp_path, deltas, "located", varied=True)
    rows = np.tile([6.0, -4.0, 3.0], (40, 1))
    keys = ("waist.roll", "shoulder.x", "elbow.z", "elbow.pitch")
    names = [f"calibration.joints.{key}" for key in keys]
    of = sensitivities(scene, rows, names)
    plant, h = Plant(scene), 1e-3
    for place, name in enumerate(names):
        ends = []
        for point in (-2.0, -1.0, 1.0, 2.0):
            plant.set_parameter(name, point * h)
            plant.reset()
            ends.append(plant.run(rows, scene.steps_per_period)[-1])
        plant.set_parameter(name, 0.0)
        by = np.array([1.0, -8.0, 8.0, -1.0]) / 12.0 @ np.array(ends) / h
        slope = of.by["q"][-1][:, place]
        assert slope == pytest.approx(by, abs=1e-6 * max(1e-3, np.abs(by).max())), name


def test_only_numbers_of_a_calibration_that_is_there_vary(tmp_path: Path) -> None:
    file = own_three_axis(tmp_path, "")
    with pytest.raises(Refusal, match="varied must name numbers of this scene"):
        load_scene(file, {"varied": ["calibration.joints.elbow.x"]})
    scene = load_scene(file, {"calibration": {}, "varied": ["calibration.joints.elbow.x"]})
    with pytest.raises(Refusal, match=r"calibration.joints.elbow.x must be a number from -1 to 1"):
        Plant(scene).set_parameter("calibration.joints.elbow.x", 1.5)
