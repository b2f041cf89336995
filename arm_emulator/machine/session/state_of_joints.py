"""Quantities of some joints that are set by hand."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.plant import Plant


class StateOfJoints:
    """Values of quantities of `PlantState` for some joints of a plant, checked.

    Args:
        plant: the machine.
        joint_names: joints of the scene, each at most once.
        given: one value per name, by names of `PlantState`; an empty one is not given.

    Raises:
        Refusal: no or other names, another number of values.
    """

    where = "set_state"

    def __init__(
        self, plant: Plant, joint_names: Sequence[str], given: Mapping[str, Sequence[float]]
    ) -> None:
        where, joints = self.where, plant.scene.joint_names
        names = list(joint_names) if isinstance(joint_names, Iterable) else [joint_names]
        count = sum(isinstance(name, str) and name in joints for name in names)
        if not names or count < len(names) or len(set(names)) < len(names):
            rule, actual = "name joints, each once", ", ".join(map(str, names)) or "none"
            raise Refusal(where, "joint names", rule, actual, ", ".join(joints))
        self._plant = plant
        self._places = [joints.index(name) for name in names]
        if not isinstance(given, Mapping):
            raise Refusal(where, "given", "be values by names of quantities", given)
        unknown = [name for name in given if name not in plant.bounds]
        if unknown:
            rule, valid = "name quantities of the state", ", ".join(plant.bounds)
            raise Refusal(where, "given", rule, ", ".join(map(str, unknown)), valid)
        self._values = {quantity: row for quantity, row in given.items() if np.size(row)}
        if not self._values:
            raise Refusal(where, "given", "have at least one quantity", "none")
        for quantity, row in self._values.items():
            if np.shape(row) != (len(names),):
                rule = f"have one value per joint name ({len(names)})"
                raise Refusal(where, plant.bounds[quantity].name, rule, f"{np.size(row)} values")

    def make_rows(self) -> dict[str, Array]:
        """Return rows of all joints (N,), by quantity: the others' values as they are now."""
        now = self._plant.state
        rows = {quantity: getattr(now, quantity).copy() for quantity in self._values}
        for quantity, row in self._values.items():
            rows[quantity][self._places] = row
        return rows
