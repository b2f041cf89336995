"""The examples for a card do there what they do on the processor: `make test-gpu`."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from arm_emulator import load_scene
from arm_emulator_fleet import Fleet

pytest_plugins = ["cards"]
pytestmark = pytest.mark.usefixtures("card")

sys.path.append(str(Path(__file__).resolve().parents[4] / "examples"))
NUMBER = "joints.elbow.friction.viscous"
ARMS, REACHED = 1000, 1e-9  # rad; portable arithmetic, but rewards are summed in another order


def to_host(numbers: Any) -> np.ndarray:
    return np.asarray(numbers.get() if hasattr(numbers, "get") else numbers.cpu())


@pytest.mark.parametrize("library", ["torch", "cupy"])
def test_an_environment_on_a_card_gives_the_numbers_of_lanes(library: str) -> None:
    from vector_env import ReachEnv  # type: ignore[import-not-found]

    xp = pytest.importorskip(library)
    scene = load_scene("three_axis", {"varied": [NUMBER]})
    lanes, card = ReachEnv(scene, ARMS, 0.05), ReachEnv(scene, ARMS, 0.05, device="gpu", xp=xp)
    np.testing.assert_array_equal(to_host(card.reset(seed=1)[0]), lanes.reset(seed=1)[0])
    rng = np.random.default_rng(2)
    for _ in range(80):
        actions = rng.uniform(-1.0, 1.0, (ARMS, 3))
        on_card, expected = card.step(card._put(actions))[:4], lanes.step(actions)[:4]
        for own, in_lanes in zip(on_card, expected, strict=True):
            np.testing.assert_allclose(
                to_host(own).astype(float), in_lanes.astype(float), 0, REACHED
            )


def test_copies_of_an_arm_on_a_card_move_as_it_does() -> None:
    arm, fleet = Fleet("three_axis", 1, device="gpu"), Fleet("three_axis", ARMS, device="gpu")
    arm.exchange([9.0, -7.0, 5.0])
    fleet.copy_state(0, of=arm)
    for _ in range(10):
        arm.exchange([1.0, 2.0, 3.0])
        fleet.exchange([1.0, 2.0, 3.0])
    assert fleet.save() == ARMS * arm.save()


@pytest.mark.parametrize("library", ["torch", "cupy"])
def test_rollouts_on_a_card_bring_an_arm_to_its_target(library: str) -> None:
    import mppi  # type: ignore[import-not-found]

    pytest.importorskip(library)
    off, times = mppi.main(device="gpu", library=library, rollouts=10_000, seconds=1.0)
    print(f"{library}: a decision by 10 000 rollouts takes {1e3 * np.median(times):.1f} ms")
    assert off[0] > 0.35 and off[-10:].mean() < 0.08
