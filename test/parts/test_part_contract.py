"""Properties of every part that a scene may have.

Six parts are tested at a time, each alone in a drive without friction and limits. They are in the
joints of a machine whose links are not coupled. The links slide, but links in compliant bearings
turn, so that motion deflects these. Commands jump, and the power is cut on the way. The test of the
part compares its motion with the truth, `test_lanes` all of them in lanes with single arms.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from draws import with_slow
from machines import GRAVITY

from arm_emulator import Plant, Scene, load_scene
from arm_emulator.machine.parts.bearing import Deflection
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.scene.known_parts import PARTS
from oracles.mixtures import (
    PERIOD,
    STEPS,
    draw_alone,
    draw_commands,
    find_converged,
    run_rows,
    write_scene,
)
from oracles.random_chain import write_slides

Parts = tuple[type[Part], ...]
DEFLECTED = 1e-6  # m or rad, by the stiffest bearing at least: a thousand times what is resolved
AXES = "1 0 0", "0 1 0", "0 0 1"
# The last ones come once more rather than leave a joint empty.
BESIDE = [(PARTS + PARTS)[k : k + 6] for k in range(0, len(PARTS), 6)]


def names(parts: Parts) -> str:
    return "-".join(part.__name__ for part in parts)


def choose_axis(k: int, part: type[Part]) -> str:
    """Return the axis of a joint, across the direction in which its bearing gives way."""
    first = "xyz".index(part.axis) + 1 if issubclass(part, Deflection) else k
    return AXES[first % 3]


def scene_of(folder: Path, parts: Parts, steps: int) -> Scene:
    joints = {f"joint{k}": draw_alone(part, 0) for k, part in enumerate(parts)}
    axes = [choose_axis(k, part) for k, part in enumerate(parts)]
    kinds = ["continuous" if issubclass(part, Deflection) else "prismatic" for part in parts]
    urdf = write_slides(joints, axes, kinds, com="0.1 0.2 0.15")
    file = write_scene(folder, urdf, joints, gravity=GRAVITY)
    scene = load_scene(file, {"integrator.dt": PERIOD / steps, "integrator.events": "located"})
    for part, joint in zip(parts, scene.joints, strict=True):
        assert any(type(joint_part) is part for joint_part in joint.parts), (
            f"{part.__name__} is there"
        )
    return scene


@pytest.mark.parametrize("parts", with_slow(((parts,) for parts in BESIDE), 1), ids=names)
def test_motions_and_the_balance_of_energy_are_of_order_two(parts: Parts, tmp_path: Path) -> None:
    rows = draw_commands(scene_of(tmp_path, parts, STEPS[0]), 0)

    @cache
    def moved(steps: int) -> tuple[np.ndarray, float]:
        return run_rows(scene_of(tmp_path, parts, steps), 0, rows, steps)

    deflected = [part for part in parts if issubclass(part, Deflection)]
    assert moved(STEPS[0])[0].shape[1] == len(parts) + len(deflected), "each deflection is judged"
    owners = [part for part in parts for _ in range(1 + (part in deflected))]
    for k, part in enumerate(owners):
        verdict, q = find_converged(
            0, [], lambda steps, k=k: (moved(steps)[0][:, k], moved(steps)[1])
        )
        is_deflection = part in owners[:k]
        least = DEFLECTED if is_deflection else 1e-3
        assert np.ptp(q) > least, f"a motion of {part.__name__} [m or rad]"
        assert verdict.is_in_order and verdict.is_balanced, f"{part.__name__}: {verdict}"


@pytest.mark.parametrize("parts", with_slow(((parts,) for parts in BESIDE), 1), ids=names)
def test_a_machine_that_is_saved_goes_on_to_the_last_bit(parts: Parts, tmp_path: Path) -> None:
    scene = scene_of(tmp_path, parts, STEPS[0])
    rows = draw_commands(scene, 1)
    plant, restored = Plant(scene), Plant(scene)
    for k, row in enumerate(rows):
        plant.powered = k % 5 != 3
        plant.advance(row, STEPS[0])
        restored.restore(saved := plant.save())
        assert restored.save() == saved, f"after row {k}"
        for machine in (plant, restored):
            machine.advance(-row, STEPS[0] // 4)
        assert restored.save() == plant.save(), f"on the way from row {k}"
