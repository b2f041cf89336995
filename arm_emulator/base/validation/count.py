"""Counts that come from outside: whole numbers that fit."""

import operator

import numpy as np
from numpy.typing import NDArray

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.coerce import coerce_array
from arm_emulator.base.validation.number import Number

LARGEST = 2**63 - 1  # the core's integer


def check_count(
    where: str, quantity: str, value: object, smallest: int = 0, largest: int = LARGEST
) -> int:
    """Return a whole number from `smallest` to `largest`, of Python or NumPy, as Python's int.

    Raises:
        Refusal: it is something else.
    """
    try:
        if isinstance(value, bool | np.bool_):
            raise TypeError
        count = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        count = None
    if count is None or not smallest <= count <= largest:
        maximum = None if largest == LARGEST else largest
        raise Number(quantity, at_least=smallest, at_most=maximum, whole=True).make_refusal(
            where, value
        )
    return count


def check_whole_numbers(where: str, quantity: str, values: object) -> NDArray[np.int64]:
    """Return a row of whole numbers (K,).

    Raises:
        Refusal: they are something else.
    """
    array = coerce_array(values)
    if array is None or array.ndim != 1 or not np.all(np.abs(array) < 2.0**53):
        raise Refusal(where, quantity, "be a row of whole numbers", values)
    if not np.array_equal(array, np.rint(array)):
        raise Refusal(where, quantity, "be whole numbers", values)
    return array.astype(np.int64)
