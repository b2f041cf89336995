"""Arguments of calls for many arms: one for all of them, or one each."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_emulator.base.bound import ANY_COMMAND
from arm_emulator.base.number import Number
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.call_arguments import Commands, by_joint
from arm_emulator.machine.chain import Array
from arm_emulator.machine.scene import Scene
from arm_emulator.machine.varied import varied_number


class FleetArguments:
    """Checks and shapes of the arguments.

    Args:
        scene: of all arms.
        count: of arms.
    """

    def __init__(self, scene: Scene, count: int) -> None:
        self._scene, self._count, self._N = scene, count, len(scene.joints)

    def column(self, where: str, name: str, values: ArrayLike, mask: NDArray[np.bool_]) -> Array:
        """Return the values of a varied number (count,), checked for those of the mask."""
        one = varied_number(self._scene.varied, name, where)
        given = one.number.numbers(where, values)
        column = np.full(self._count, one.value, np.float64)
        many = int(mask.sum())
        if given.shape not in ((), (many,), (self._count,)):
            shapes = " or ".join(f"({n},)" for n in sorted({many, self._count}))
            raise Refusal(where, name, f"have shape {shapes} or ()", given.shape)
        column[mask] = given[mask] if given.shape == (self._count,) else given
        one.number.check(where, column)
        return column

    def commands(self, command: Commands, where: str, bound: Number = ANY_COMMAND) -> Array:
        """Return commands (count, N), given for all arms, one each, or by names of joints."""
        given = by_joint(command, self._scene, where)
        if given is not command:
            columns = [bound.numbers(where, one) for one in given]  # type: ignore[attr-defined]
            if any(one.shape not in ((), (self._count,)) for one in columns):
                shapes = [one.shape for one in columns]
                rule = f"have shape () or ({self._count},) for each joint"
                raise Refusal(where, bound.name, rule, shapes)
            given = np.column_stack([np.broadcast_to(one, self._count) for one in columns])
        return self.rows(given, None, where, bound)

    def rows(self, values: Any, mask: NDArray[np.bool_] | None, where: str, bound: Number) -> Array:
        """Return a row for each arm, checked; those of other arms than the mask's are 0."""
        given = bound.numbers(where, values)
        shape = (self._count, self._N)
        many = self._count if mask is None else int(mask.sum())
        if given.shape not in ((self._N,), (many, self._N), shape):
            shapes = " or ".join(f"({n}, {self._N})" for n in sorted({many, self._count}))
            raise Refusal(where, bound.name, f"have shape ({self._N},) or {shapes}", given.shape)
        if mask is None and given.shape == shape:
            rows = given
        elif mask is None or mask.all():
            rows = np.ascontiguousarray(np.broadcast_to(given, shape))
        else:
            rows = np.zeros(shape)
            rows[mask] = given[mask] if given.shape == shape else given
        bound.check(where, rows)
        return rows
