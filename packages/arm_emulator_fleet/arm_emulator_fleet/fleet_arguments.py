"""Arguments of the calls of a fleet: their checks, and their shapes for all of its arms."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_emulator.extension.base import ANY_COMMAND, Array, Number, Refusal
from arm_emulator.extension.machine import Commands, Scene, find_varied, order_by_joint


class FleetArguments:
    """Checks and shapes of the arguments.

    Args:
        scene: of all arms.
        count: of arms.
    """

    def __init__(self, scene: Scene, count: int) -> None:
        self._scene, self._count, self._N = scene, count, len(scene.joints)

    def read_column(
        self, where: str, name: str, values: ArrayLike, mask: NDArray[np.bool_]
    ) -> Array:
        """Return the values of a varied number (count,), checked for those of the mask."""
        varied = find_varied(self._scene.varied, name, where)
        numbers = varied.number.check_numbers(where, values)
        column = np.full(self._count, varied.value, np.float64)
        many = int(mask.sum())
        if numbers.shape not in ((), (many,), (self._count,)):
            shapes = " or ".join(f"({n},)" for n in sorted({many, self._count}))
            raise Refusal(where, name, f"have shape {shapes} or ()", numbers.shape)
        column[mask] = numbers[mask] if numbers.shape == (self._count,) else numbers
        varied.number.check_values(where, column)
        return column

    def read_commands(self, command: Commands, where: str, bound: Number = ANY_COMMAND) -> Array:
        """Return commands (count, N), given for all arms, one each, or by names of joints."""
        ordered = order_by_joint(command, self._scene, where)
        if ordered is not command:
            columns = [bound.check_numbers(where, column) for column in ordered]  # type: ignore[attr-defined]
            if any(column.shape not in ((), (self._count,)) for column in columns):
                shapes = [column.shape for column in columns]
                rule = f"have shape () or ({self._count},) for each joint"
                raise Refusal(where, bound.name, rule, shapes)
            ordered = np.column_stack([np.broadcast_to(column, self._count) for column in columns])
        return self.read_rows(ordered, None, where, bound)

    def read_rows(
        self, values: Any, mask: NDArray[np.bool_] | None, where: str, bound: Number
    ) -> Array:
        """Return a row for each arm, checked; those of other arms than the mask's are 0."""
        numbers = bound.check_numbers(where, values)
        shape = (self._count, self._N)
        many = self._count if mask is None else int(mask.sum())
        if numbers.shape not in ((self._N,), (many, self._N), shape):
            shapes = " or ".join(f"({n}, {self._N})" for n in sorted({many, self._count}))
            raise Refusal(where, bound.name, f"have shape ({self._N},) or {shapes}", numbers.shape)
        if mask is None and numbers.shape == shape:
            rows = numbers
        elif mask is None or mask.all():
            rows = np.ascontiguousarray(np.broadcast_to(numbers, shape))
        else:
            rows = np.zeros(shape)
            rows[mask] = numbers[mask] if numbers.shape == shape else numbers
        bound.check_values(where, rows)
        return rows


def choose_arms(where: str, arms: ArrayLike | None, count: int) -> NDArray[np.bool_]:
    """Return which arms are chosen, as a mask (count,).

    Args:
        where: for refusals.
        arms: a mask (count,) or indices; None: all.
        count: of arms.

    Raises:
        Refusal: no such arms.
    """
    if arms is None:
        return np.ones(count, bool)
    try:
        chosen = np.asarray(arms)
    except Exception:  # any error of a foreign object means that it has no numbers
        chosen = np.asarray(None)
    if chosen.dtype == np.bool_ and chosen.shape == (count,):
        return np.ascontiguousarray(chosen)
    mask = np.zeros(count, bool)
    are_indices = chosen.dtype.kind in "iu" or chosen.size == 0
    if not are_indices or chosen.ndim > 1 or (np.abs(chosen + 0.5) > count).any():
        raise Refusal(where, "arms", f"be a mask of {count}, or indices of {count} arms", arms)
    mask[chosen.astype(np.int64)] = True
    if mask.sum() < chosen.size:  # such as a mask of 0 and 1
        raise Refusal(where, "arms", f"be a mask of {count}, or indices, each once", arms)
    return mask
