"""Properties of every part that a scene may have.

Each part alone in a drive without friction and limits, moved by commands that jump, the power cut
on the way. The test of the part compares its motion with the truth.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from draws import some

from arm_emulator.machine.parts.known import PARTS
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.scene import Scene, load_scene
from oracles.mixtures import (
    AS_ALONE,
    PERIOD,
    STEPS,
    commands,
    converge,
    lanes_apart,
    run,
    write_alone,
)

every_part = pytest.mark.parametrize("part", PARTS, ids=lambda part: part.__name__)


def in_steps(file: Path, steps: int, events: str = "located") -> Scene:
    return load_scene(file, {"integrator.dt": PERIOD / steps, "integrator.events": events})


@every_part
def test_its_motion_and_the_balance_of_energy_are_of_order_two(
    part: type[Part], tmp_path: Path
) -> None:
    file = write_alone(tmp_path, part, 0)
    scene = in_steps(file, STEPS[0])
    assert any(type(one) is part for joint in scene.joints for one in joint.parts), "it is there"
    rows = commands(scene, 0)
    verdict, q = converge(0, [], lambda steps: run(in_steps(file, steps), 0, rows, steps))
    assert np.ptp(q) > 1e-3, "a motion [rad or m]"
    assert verdict.in_order and verdict.balanced, verdict


@every_part
def test_a_machine_that_is_saved_goes_on_to_the_last_bit(part: type[Part], tmp_path: Path) -> None:
    scene = in_steps(write_alone(tmp_path, part, 0), STEPS[0])
    rows = commands(scene, 1)
    plant, other = Plant(scene), Plant(scene)
    for k, row in enumerate(rows):
        plant.powered = k % 5 != 3
        plant.advance(row, STEPS[0])
        other.restore(saved := plant.save())
        assert other.save() == saved, f"after row {k}"
        for one in (plant, other):
            one.advance(-row, STEPS[0] // 4)
        assert other.save() == plant.save(), f"on the way from row {k}"


@pytest.mark.parametrize("part", some(PARTS[::-1], 1), ids=lambda part: part.__name__)
def test_four_in_lanes_move_as_each_alone(part: type[Part], tmp_path: Path) -> None:
    scene = in_steps(write_alone(tmp_path, part, 0), STEPS[1], "step")
    assert lanes_apart(scene, 0, commands(scene, 0)) < AS_ALONE, "rad or m"
