"""Power acts wherever a machine goes on: by exchange, advance, rows, with a meter, in a fleet."""

from collections.abc import Callable

import numpy as np
import pytest
from draws import some

from arm_emulator import Plant, Scene, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator_fleet import Fleet


def fed(plant: Plant, V: Array) -> None:
    plant.advance(V, 40)


def rows(plant: Plant, V: Array) -> None:
    plant.run(np.tile(V, (4, 1)), 10)


def metered(plant: Plant, V: Array) -> None:
    flow = plant.advance_metered(V, 40)
    assert plant.powered or not flow.supplied.any(), "nothing is given without power"


def exchanged(plant: Plant, V: Array) -> None:
    for _ in range(4):
        plant.exchange(V)


CALLS = [fed, rows, metered, exchanged]


def moved(scene: Scene, drive: Callable[[Plant, Array], None], on: bool, V: Array) -> Array:
    plant = Plant(scene)
    plant.powered = on
    drive(plant, V)
    state = plant.state
    return np.array([*state.q, *state.v, *state.current])


@pytest.mark.parametrize("drive", CALLS)
@pytest.mark.parametrize("sensed", some([True, False], 1))
def test_without_power_commands_are_nothing(
    drive: Callable[[Plant, Array], None], sensed: bool
) -> None:
    """As under 0 V, to the last bit; and not as with power."""
    keys: dict[str, object] = {"energy_flow": True, "integrator.dt": 1e-4}
    if sensed:
        keys["joints.elbow.encoder.noise"] = 1e-3
    scene, V = load_scene("three_axis", keys), np.array([9.0, -5.0, 7.0])
    off = moved(scene, drive, False, V)
    np.testing.assert_array_equal(off, moved(scene, drive, True, 0.0 * V))
    assert np.abs(moved(scene, drive, True, V) - off).max() > 1e-3
    plant = Plant(scene)
    plant.powered = False
    assert not plant.powers(V).supplied.any()


def test_arms_of_a_fleet_have_independent_power() -> None:
    scene, V = load_scene("three_axis", {"integrator.dt": 1e-4}), np.array([9.0, -5.0, 7.0])
    fleet = Fleet(scene, 11)
    off = [0, 3, 4, 10]
    for arm in off:
        fleet[arm].powered = False
    q = fleet.run(np.tile(V, (3, 1)), 20)
    plants = {on: Plant(scene) for on in (True, False)}
    for on, plant in plants.items():
        plant.powered = on
        expected = plant.run(np.tile(V, (3, 1)), 20)
        arms = [k for k in range(11) if (k not in off) == on]
        np.testing.assert_allclose(
            q[:, arms], np.repeat(expected[:, None], len(arms), 1), atol=1e-12
        )
    assert np.abs(q[-1, 0] - q[-1, 1]).max() > 1e-4
