"""Counts that come from outside: whole numbers that fit."""

from __future__ import annotations

import operator

import numpy as np

from arm_emulator.base.number import Number

LARGEST = 2**63 - 1  # the core's integer


def check_count(
    where: str, quantity: str, value: object, least: int = 0, largest: int = LARGEST
) -> int:
    """Return a whole number from `least` to `largest`, of Python or NumPy, as Python's int.

    Raises:
        Refusal: it is something else.
    """
    try:
        if isinstance(value, bool | np.bool_):
            raise TypeError
        count = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        count = None
    if count is None or not least <= count <= largest:
        most = None if largest == LARGEST else largest
        raise Number(quantity, at_least=least, at_most=most, whole=True).refusal(where, value)
    return count
