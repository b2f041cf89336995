"""Fleets on a card have the bits of the processor, in any size and block: `make test-gpu`."""

import numpy as np
import pytest

from arm_emulator import load_gains, load_scene
from arm_emulator.extension.machine import PowerChange
from arm_emulator_fleet import Fleet, ServoFleet
from arm_emulator_fleet.fleet_schedule import FleetWay

pytest_plugins = ["cards"]
pytestmark = pytest.mark.usefixtures("card")

PERIODS = 300
BLOCKS = (32, 64, 128, 256)
COUNTS = (63, 1000, 20_000)
COMPARED = 63  # arms of each fleet; the processor would take minutes for all


def follow(name: str, count: int, device: str | None, block: int = 0) -> dict[str, np.ndarray]:
    """Return where arms are that move, meet a loss of power and stop, each on a way of its own."""
    scene = load_scene(name)
    fleet = Fleet(scene, count, device=device)
    if block:
        fleet.core.block = block
    servos = ServoFleet(fleet, load_gains(name).servo)
    away = np.random.default_rng(4).uniform(-0.5, 0.5, (COUNTS[-1], len(scene.joints)))[:count]
    rise = np.minimum(1.0, np.linspace(0.0, 2.0, PERIODS))[:, np.newaxis, np.newaxis]
    servos.aim(scene.start + rise * away)
    schedule = FleetWay(scene, count)
    schedule.set_changes(
        [[(200 + k % 50, PowerChange(on=False))] if k % 3 == 0 else [] for k in range(count)]
    )
    frame = fleet.follow(servos, PERIODS, way=schedule)
    names = "q", "v", "current", "t", "faults"
    return {name: np.array(getattr(frame, name))[:COMPARED] for name in names}


@pytest.mark.parametrize("name", ["three_axis", "ur5", "panda"])
def test_a_card_gives_the_bits_of_the_processor(name: str) -> None:
    expected = follow(name, COMPARED, None)
    for count in COUNTS:
        for block in BLOCKS if name == "three_axis" else BLOCKS[1:2]:
            for _ in range(3 if name == "three_axis" else 1):
                on_card = follow(name, count, "gpu", block)
                for key, values in expected.items():
                    np.testing.assert_array_equal(
                        on_card[key], values, f"{name} {count} {block} {key}"
                    )


def test_a_saved_fleet_goes_on_from_a_card_on_the_processor() -> None:
    scene = load_scene("ur5")
    card, lanes = Fleet(scene, 8, device="gpu"), Fleet(scene, 8)
    commands = np.random.default_rng(5).uniform(-5.0, 5.0, (8, len(scene.joints)))
    card.advance(commands, 500)
    lanes.restore(card.save())
    np.testing.assert_array_equal(card.advance(-commands, 500), lanes.advance(-commands, 500))
