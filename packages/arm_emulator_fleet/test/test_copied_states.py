"""One arm's state in others, in lanes and on a device: all of it, to the last bit."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from machines import SENSED
from test_fleet_step import LOCATED

from arm_emulator import Plant, Refusal, Scene, load_scene
from arm_emulator_fleet import Fleet

COUNT, SOURCE = 11, 6  # more than one group of lanes, and none that is full
NUMBER = "joints.elbow.friction.viscous"
DEVICES = [None, "processor"]


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Sensors with noise of each arm, and a brake with delays."""
    return load_scene("three_axis", overrides=SENSED)


def move(scene: Scene, device: str | None, seed: int) -> Fleet:
    """Return arms in motion, each with numbers of its own."""
    rng = np.random.default_rng(seed)
    varied = {NUMBER: rng.uniform(1.0, 5.0, COUNT), "seed": rng.integers(0, 99, COUNT)}
    q = rng.uniform(-1.0, 1.0, (COUNT, 3))
    fleet = Fleet(scene, COUNT, varied=varied, q=q, device=device, workers=1)
    for row in rng.uniform(-9.0, 9.0, (7, COUNT, 3)):
        fleet.exchange(row)
    return fleet


def states(fleet: Fleet) -> list[bytes]:
    saved = fleet.save()
    size = len(saved) // COUNT
    return [saved[arm * size : (arm + 1) * size] for arm in range(COUNT)]


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize(
    ("arms", "chosen"),
    [
        (None, range(COUNT)),
        ([0, 3, 10], [0, 3, 10]),
        (np.arange(COUNT) % 2 == 1, range(1, COUNT, 2)),
        (SOURCE, []),
        ([], []),
    ],
    ids=range(5),
)
def test_chosen_arms_continue_from_a_saved_arm(
    device: str | None, arms: Any, chosen: Iterable[int], scene: Scene
) -> None:
    fleet = move(scene, device, 1)
    before = states(fleet)
    assert len(set(before)) == COUNT
    expected = before.copy()
    for arm in chosen:
        expected[arm] = before[SOURCE]
    fleet.copy_state(SOURCE, arms)
    assert states(fleet) == expected


@pytest.mark.parametrize("device", DEVICES)
def test_copies_of_an_arm_of_another_fleet_move_as_it_does(
    device: str | None, scene: Scene
) -> None:
    fleet, source = move(scene, device, 1), move(scene, device, 2)
    before = states(source)
    fleet.copy_state(-1, of=source)
    assert states(source) == before, "a source stays as it is"
    assert set(states(fleet)) == {before[-1]}
    for row in np.random.default_rng(3).uniform(-9.0, 9.0, (9, 3)):
        fleet.exchange(row)
        source.exchange(row)
    assert set(states(fleet)) == {states(source)[-1]}, "noise and numbers, too"


@pytest.mark.slow
@pytest.mark.parametrize("device", DEVICES)
def test_a_saved_plant_is_restored_in_chosen_arms(device: str | None, scene: Scene) -> None:
    fleet, plant = move(scene, device, 1), Plant(scene)
    plant.exchange(np.array([3.0, -4.0, 5.0]))
    before = states(fleet)
    fleet.restore(plant.save(), arms=[2, 5])
    expected = [plant.save() if arm in (2, 5) else before[arm] for arm in range(COUNT)]
    assert states(fleet) == expected
    assert fleet.copy_arm(5).save() == plant.save()


@pytest.mark.parametrize("device", DEVICES)
def test_a_refused_copy_changes_nothing(device: str | None, scene: Scene) -> None:
    fleet = move(scene, device, 1)
    before = fleet.save()
    faster = load_scene("three_axis", overrides={**SENSED, "integrator.dt": 5e-4})
    other = load_scene("three_axis", overrides=LOCATED)
    elsewhere = "processor" if device is None else None
    for arm, arms, of, reason in (
        (COUNT, None, None, "arm must"),
        (-COUNT - 1, None, None, "arm must"),
        ("0", None, None, "arm must"),
        (0, [COUNT], None, "arms must"),
        (0, None, Plant(scene), "of must be a fleet on"),
        (0, None, Fleet(scene, 1, device=elsewhere), "of must be a fleet on"),
        (0, None, Fleet(other, 1, device=device), "of must be a fleet of this scene"),
        (0, None, Fleet(faster, 1, device=device), "arm 0: saved machine must have this step"),
    ):
        with pytest.raises(Refusal, match=f"Fleet.copy_state: {reason}"):
            fleet.copy_state(arm, arms, of=of)  # type: ignore[arg-type]
    spoiled = bytearray(fleet.save()[: len(before) // COUNT])
    spoiled[-20] ^= 1
    with pytest.raises(Refusal, match=r"arm 3: saved machine must be as it was saved"):
        fleet.restore(spoiled, arms=[3, 4])
    assert fleet.save() == before
