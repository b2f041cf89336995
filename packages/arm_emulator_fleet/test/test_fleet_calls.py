"""A fleet has what a plant has: every call on all arms is that call on each of them alone."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import FULL, some
from machines import SENSED

from arm_emulator import Plant, Refusal, Scene, load_scene
from arm_emulator.machine.plant.outputs import KNOWN
from arm_emulator_fleet import Fleet
from oracles.random_machines import write_machine

COUNT = 11  # more than one group, and none that is full
NUMBER = "joints.elbow.friction.viscous"


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("three_axis", overrides=SENSED)


def alone(fleet: Fleet, arm: int, **began: Any) -> Plant:
    plant = Plant(fleet.scene)
    for name, values in fleet.parameters.items():
        plant.set_parameter(name, values[arm])
    plant.reset(**began)
    return plant


def assert_alike(fleet: Fleet, plants: list[Plant]) -> None:
    measured, state = fleet.measured, fleet.state
    for arm, plant in enumerate(plants):
        for name in KNOWN:
            of_arm, of_plant = getattr(measured, name)[arm], getattr(plant.measured, name)
            np.testing.assert_array_equal(of_arm, of_plant, err_msg=f"{name} of arm {arm}")
        for name in ("t", "q", "v", "current", "theta_m", "omega_m"):
            of_arm, of_plant = getattr(state, name)[arm], getattr(plant.state, name)
            np.testing.assert_array_equal(of_arm, of_plant, err_msg=f"{name} of arm {arm}")
        assert fleet.powered[arm] == plant.powered


@pytest.mark.parametrize("device", [None, "processor"])
@pytest.mark.parametrize("seed", some(range(5), 1))
def test_exchanges_under_power_and_without(seed: int, device: str | None, scene: Scene) -> None:
    """Brakes, sensors with noise of their own, an emergency stop of some arms on the way."""
    rng = np.random.default_rng(seed)
    varied = {NUMBER: rng.uniform(1.0, 5.0, COUNT), "seed": np.arange(COUNT)}
    q = rng.uniform(-1.0, 1.0, (COUNT, 3))
    workers = 2 if device is None else None
    fleet = Fleet(scene, COUNT, varied=varied, q=q, workers=workers, device=device)
    for name, values in varied.items():
        assert np.array_equal(fleet.parameters[name], values), name
    plants = [alone(fleet, arm, q=q[arm]) for arm in range(COUNT)]
    commands = rng.uniform(-20.0, 20.0, (30, COUNT, 3))
    for tick, rows in enumerate(commands):
        if tick == 10:
            on = rng.random(COUNT) < 0.5
            assert on.any() and not on.all()
            fleet.powered = on
            for plant, has_power in zip(plants, on, strict=True):
                plant.powered = bool(has_power)
        if tick == 20:
            fleet.powered = True
            for plant in plants:
                plant.powered = True
        fleet.exchange(rows, tick)
        for plant, row in zip(plants, rows, strict=True):
            plant.exchange(row, tick)
        if tick in (5, 13, 29):
            assert_alike(fleet, plants)
    assert np.ptp(fleet.measured.current[:, 1]) > 0.0


@pytest.mark.parametrize("arms", [[2, 5], np.arange(COUNT) == 4, -1, slice, []], ids=range(5))
def test_some_arms_are_reset_and_the_others_go_on(arms: Any, scene: Scene) -> None:
    rng = np.random.default_rng(1)
    arms = None if arms is slice else arms
    mask = np.zeros(COUNT, bool)
    mask[
        slice(None) if arms is None else np.asarray(arms, None if len(np.atleast_1d(arms)) else int)
    ] = True
    fleet = Fleet(scene, COUNT)
    fleet.run(rng.uniform(-9.0, 9.0, (5, COUNT, 3)), 20)
    before, many = [arm.save() for arm in fleet], int(mask.sum())
    q, v = rng.uniform(-1.0, 1.0, (2, COUNT, 3))
    numbers = rng.uniform(2.0, 4.0, many)
    fleet.reset(arms, q=q[mask], v=v, varied={NUMBER: numbers})
    expected = Plant(scene)
    which = iter(numbers)
    for arm, plant in enumerate(fleet):
        if not mask[arm]:
            assert plant.save() == before[arm], f"arm {arm} was left out"
            continue
        number = next(which)
        expected.set_parameter(NUMBER, number)
        expected.reset(q[arm], v[arm])
        assert fleet.parameters[NUMBER][arm] == number
        assert np.array_equal(plant.state.q, q[arm]) and np.array_equal(plant.state.v, v[arm])
        assert np.array_equal(plant.state.theta_m, expected.state.theta_m) and plant.t == 0.0


def test_numbers_of_some_arms(scene: Scene) -> None:
    fleet = Fleet(scene, COUNT)
    fleet.set_parameter(NUMBER, 2.0)
    fleet.set_parameter(NUMBER, [3.0, 4.0], arms=[7, 9])
    fleet.set_parameter(NUMBER, np.arange(COUNT) + 10.0, arms=np.arange(COUNT) == 3)
    expected = np.full(COUNT, 2.0)
    expected[[7, 9, 3]] = 3.0, 4.0, 13.0
    assert np.array_equal(fleet.parameters[NUMBER], expected)
    assert [arm.parameters[NUMBER] for arm in fleet] == expected.tolist()


def test_a_saved_fleet_goes_on_to_the_last_bit(scene: Scene) -> None:
    rows = np.random.default_rng(2).uniform(-9.0, 9.0, (8, COUNT, 3))
    fleet = Fleet(scene, COUNT, workers=2)
    fleet.run(rows, 25)
    saved = fleet.save()
    assert saved == b"".join(arm.save() for arm in fleet)
    end = fleet.run(rows, 25)
    second = Fleet(scene, COUNT)
    second.restore(saved)
    assert second.run(rows, 25).tobytes() == end.tobytes()
    after = fleet.save()
    fleet.restore(saved, arms=[1, 2])
    size = len(saved) // COUNT
    for arm, plant in enumerate(fleet):
        full = saved if arm in (1, 2) else after
        assert plant.save() == full[arm * size : (arm + 1) * size]
    spoiled = bytearray(saved)
    spoiled[-20] ^= 1  # of the last arm: none of those before may change
    before = fleet.save()
    with pytest.raises(Refusal, match=r"arm 10: saved machine must be as it was saved"):
        fleet.restore(spoiled)
    assert fleet.save() == before


def test_commands_by_names_of_joints(scene: Scene) -> None:
    first, second = Fleet(scene, COUNT), Fleet(scene, COUNT)
    rows = np.zeros((COUNT, 3))
    rows[:, 2], rows[:, 0] = np.arange(COUNT), 5.0
    first.exchange({"elbow": np.arange(COUNT), "waist": 5, "shoulder": 0.0})
    second.exchange(rows)
    assert first.save() == second.save()


@pytest.mark.skipif(not FULL, reason="two threads are compiled for it: make test-in-full")
def test_exchanges_without_lanes(tmp_path: Path) -> None:
    file, _ = write_machine(tmp_path, 23)
    more = {"integrator.scheme": "extrapolated", "integrator.dt": 2e-4, "threads": 2}
    scene = load_scene(file, more)
    rows = np.random.default_rng(3).uniform(-9.0, 9.0, (10, 3, len(scene.joints)))
    fleet, plants = Fleet(scene, 3), [Plant(scene) for _ in range(3)]
    assert fleet.lanes == 1
    for row in rows:
        fleet.exchange(row)
        for plant, own in zip(plants, row, strict=True):
            plant.exchange(own)
    # Between the name of the library, which differs, and the sum over all.
    assert [arm.save()[8:-8] for arm in fleet] == [plant.save()[8:-8] for plant in plants]
