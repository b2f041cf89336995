"""Readings to the last bit: seeds, pieces of time, restored machines, lanes, real time."""

from __future__ import annotations

import numpy as np
import pytest
from draws import FULL
from sensed_machine import FIELDS, motion, noisy, rows, same, set_all, truth, write

from arm_emulator import Scene, load_scene
from arm_emulator.machine.session.real_time import RealTimeLoop
from arm_emulator_fleet import Fleet


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return load_scene(write(tmp_path_factory.mktemp("sensed")))


def test_the_same_seed_gives_the_same_bits_and_another_one_others(scene: Scene) -> None:
    one, again, other = (
        motion(noisy(scene, seed), np.random.default_rng(6), 100) for seed in (1.0, 1.0, 2.0)
    )
    assert all(same(a, b) for (a, _), (b, _) in zip(one, again, strict=True)), "the same seed"
    for name in ("encoder_counts", "current", "torque", "specific_force", "angular_rate"):
        assert not np.array_equal(rows(one, name), rows(other, name)), f"{name} of another seed"
    np.testing.assert_array_equal(truth(one, "q"), truth(other, "q"), "the same motion")


def test_steps_in_any_pieces_give_the_same_bits(scene: Scene) -> None:
    rng = np.random.default_rng(9)
    one, other = noisy(scene, 4.0), noisy(scene, 4.0)
    for _ in range(60):
        voltage = rng.normal(0.0, 20.0, 3)
        one.exchange(voltage)
        left = scene.steps_per_period
        while left:
            some = min(left, int(rng.integers(1, 4)))
            if rng.random() < 0.5:
                other.advance(voltage, some)
            else:
                other.run([voltage], some)
            left -= some
        mine, its = one.measured, other.measured
        for field in set(FIELDS) - {"applied"}:  # which only an exchange reports
            assert getattr(mine, field).tobytes() == getattr(its, field).tobytes(), field


def test_measurements_hold_until_the_next_tick(scene: Scene) -> None:
    plant = noisy(scene, 4.0)
    motion(plant, np.random.default_rng(2), 20)
    before = plant.measured
    plant.advance([20.0, 20.0, 20.0], scene.steps_per_period - 1)
    assert same(plant.measured, before), "between ticks"
    plant.advance([20.0, 20.0, 20.0], 1)
    assert not same(plant.measured, before), "at the tick"


def test_a_restored_machine_measures_on_to_the_last_bit(scene: Scene) -> None:
    one, other = noisy(scene, 4.0), noisy(scene, 9.0)
    motion(one, np.random.default_rng(2), 77)
    motion(other, np.random.default_rng(3), 33)
    other.restore(one.save())
    assert same(one.measured, other.measured), "at once"
    after = [motion(plant, np.random.default_rng(4), 100) for plant in (one, other)]
    assert all(same(a, b) for (a, _), (b, _) in zip(*after, strict=True)), "from there on"
    assert one.save() == other.save(), "all that the machine is"


@pytest.mark.skipif(not FULL, reason="lanes are compiled once more for it: make test-in-full")
def test_lanes_of_a_fleet_measure_as_single_arms(scene: Scene) -> None:
    """Each with a seed of its own; what is drawn is equal, the motions to some 1e-12."""
    rng, count = np.random.default_rng(10), 9  # more than a group
    numbers = {one.name: 0.02 for one in scene.varied if one.name.endswith(("noise", "missed"))}
    numbers |= {one.name: 1e-6 for one in scene.varied if one.name.endswith("resolution")}
    seeds = np.arange(count, dtype=float)
    fleets = [Fleet(scene, count, varied={**numbers, "seed": seeds}) for _ in range(2)]
    voltages = rng.normal(0.0, 20.0, (12, count, 3))
    steps = 7  # some rows end between two ticks
    for fleet in fleets:
        fleet.run(voltages, steps)
    for arm in range(count):
        mine = fleets[0][arm].measured
        assert same(mine, fleets[1][arm].measured), "two fleets"
        plant = noisy(scene, float(arm))
        set_all(plant, numbers)
        plant.reset()
        for row in voltages[:, arm]:
            plant.advance(row, steps)
        alone = plant.measured
        for field in FIELDS:
            # A motion that is off by 1e-12 may be at the edge of a count.
            atol = 1.0 if getattr(mine, field).dtype == np.int64 else 2e-6
            np.testing.assert_allclose(
                getattr(mine, field), getattr(alone, field), rtol=0, atol=atol, err_msg=field
            )
    for field in ("encoder_counts", "torque", "specific_force"):
        reported = [getattr(fleets[0][arm].measured, field).tobytes() for arm in range(count)]
        assert len(set(reported)) == count, f"each arm has noise of its own: {field}"
    alike = Fleet(scene, 2, varied={**numbers, "seed": 3.0})
    alike.run(voltages[:, 0], steps)
    assert same(alike[0].measured, alike[1].measured), "equal arms with equal seeds"
    np.testing.assert_array_equal(
        fleets[0].measured.encoder_counts,
        [fleets[0][k].measured.encoder_counts for k in range(count)],
    )


def test_real_time_measures_the_bits_of_exchanges(scene: Scene) -> None:
    timed, plant = noisy(scene, 4.0), noisy(scene, 4.0)
    loop = RealTimeLoop(timed, 10**6, -1)
    loop.command(0, np.array([10.0, 10.0, 10.0]))
    loop.start(0)
    reached = []
    while len(reached) < 40 and loop.wait(10.0):
        while (one := loop.take()) is not None:
            reached.append(one)
    loop.stop()
    assert len(reached) >= 40, "ticks of the loop"
    for one in reached:
        plant.exchange(np.array([10.0, 10.0, 10.0]))
        assert same(one.measured, plant.measured), f"tick {one.tick}"
