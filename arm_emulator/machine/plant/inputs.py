"""Inputs of a machine, as declared by its motors."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.parts.input import Input
from arm_emulator.machine.plant.core_calls import ARM
from arm_emulator.machine.scene.joint import Joint
from arm_emulator.machine.scene.scene import Scene


def list_further_inputs(scene: Scene) -> tuple[str, ...]:
    """Return the names of motors' further inputs, a row each in arm.h."""
    names = (input.name for joint in scene.joints for input in joint.inputs[1:])
    return tuple(dict.fromkeys(names))


def find_input(joint: Joint, name: str) -> Input | None:
    """Return a further input of a joint's motor; None: it has none of that name."""
    return next((input for input in joint.inputs[1:] if input.name == name), None)


def list_input_units(scene: Scene, name: str) -> tuple[str, ...]:
    """Return the unit of a further input at each joint; a joint without it has that of another."""
    at = [find_input(joint, name) for joint in scene.joints]
    unit = next(joint_input.unit for joint_input in at if joint_input)
    return tuple(joint_input.unit if joint_input else unit for joint_input in at)


def list_modes(scene: Scene) -> list[int]:
    """Return the enum arm_mode of each joint's command."""
    return [ARM.get_constant(joint.inputs[0].mode) for joint in scene.joints]


def check_inputs(where: str, scene: Scene, names: Iterable[str]) -> None:
    """Refuse names of further inputs that no motor of a scene has."""
    inputs = list_further_inputs(scene)
    for name in names:
        if name not in inputs:
            rule = f"be a further input of {scene.name}"
            raise Refusal(where, "inputs", rule, name, ", ".join(inputs) or "none")


def name_inputs(
    where: str, names: Sequence[str], values: Sequence[float], joints: int
) -> dict[str, Sequence[float]]:
    """Return further inputs by name, of a message that has names, and a value per joint for each.

    Raises:
        Refusal: a name twice, or another number of values.
    """
    if len(set(names)) < len(names):
        raise Refusal(where, "input_names", "name each input once", ", ".join(names))
    if len(values) != joints * len(names):
        rule = f"have {joints * len(names)} values, one per joint name for each of input_names"
        raise Refusal(where, "inputs", rule, f"{len(values)} values")
    return {name: values[k * joints : (k + 1) * joints] for k, name in enumerate(names)}


def arrange_further_rows(
    where: str, scene: Scene, row_by_name: Mapping[str, Array], *shape: int
) -> Array | None:
    """Return further inputs as rows of arm.h, 0 of those that are not given; None if none are.

    Args:
        where: name for refusals.
        scene: of the machine.
        row_by_name: rows by name.
        shape: of what stands before the rows, of a fleet.

    Raises:
        Refusal: a name that no motor of the scene has, or a joint that is given one which its motor
            has not.
    """
    if not row_by_name:
        return None
    check_inputs(where, scene, row_by_name)
    names = list_further_inputs(scene)
    rows = np.zeros((*shape, len(names), len(scene.joints)))
    for name, row in row_by_name.items():
        for j, joint in enumerate(scene.joints):
            if find_input(joint, name) is None and row[..., j].any():
                rule, actual = "be 0, its motor has no such input", row[..., j].tolist()
                raise Refusal(where, f"{name} of {joint.name}", rule, actual)
        rows[..., names.index(name), :] = row
    return rows
