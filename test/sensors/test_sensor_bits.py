"""Readings to the last bit: seeds, pieces of time, restored machines."""

import numpy as np
import pytest
from sensed_machine import FIELDS, motion, noisy, rows, same, truth, write

from arm_emulator import Scene, load_scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return load_scene(write(tmp_path_factory.mktemp("sensed")))


def test_the_same_seed_gives_the_same_bits_and_a_new_seed_new_bits(scene: Scene) -> None:
    first, second, third = (
        motion(noisy(scene, seed), np.random.default_rng(6), 100) for seed in (1.0, 1.0, 2.0)
    )
    assert all(same(a, b) for (a, _), (b, _) in zip(first, second, strict=True)), "the same seed"
    for name in ("encoder_counts", "current", "torque", "specific_force", "angular_rate"):
        assert not np.array_equal(rows(first, name), rows(third, name)), f"{name} of another seed"
    np.testing.assert_array_equal(truth(first, "q"), truth(third, "q"), "the same motion")


def test_steps_in_any_pieces_give_the_same_bits(scene: Scene) -> None:
    rng = np.random.default_rng(9)
    exchanged, stepped = noisy(scene, 4.0), noisy(scene, 4.0)
    for _ in range(60):
        voltage = rng.normal(0.0, 20.0, 3)
        exchanged.exchange(voltage)
        left = scene.steps_per_period
        while left:
            some = min(left, int(rng.integers(1, 4)))
            if rng.random() < 0.5:
                stepped.advance(voltage, some)
            else:
                stepped.run([voltage], some)
            left -= some
        mine, its = exchanged.measured, stepped.measured
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
    saved, restored = noisy(scene, 4.0), noisy(scene, 9.0)
    motion(saved, np.random.default_rng(2), 77)
    motion(restored, np.random.default_rng(3), 33)
    restored.restore(saved.save())
    assert same(saved.measured, restored.measured), "at once"
    after = [motion(plant, np.random.default_rng(4), 100) for plant in (saved, restored)]
    assert all(same(a, b) for (a, _), (b, _) in zip(*after, strict=True)), "from there on"
    assert saved.save() == restored.save(), "all that the machine is"
