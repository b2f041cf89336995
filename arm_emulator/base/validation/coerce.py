"""Flags and rows of numbers from callers: Python's, or NumPy's of any width.

``True`` is not a number and 1 is not a flag, anywhere.
"""

from typing import TypeVar

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal

_FLAGS = (bool, np.bool_)
Kind = TypeVar("Kind")


def coerce_array(values: object) -> Array | None:
    """Return `values` as an array of numbers in rows; a copy only if their type differs.

    None: one of them is not a real number.
    """
    if isinstance(values, np.ndarray) and values.dtype == np.float64 and values.flags.c_contiguous:
        return values
    try:
        array = np.asarray(values)
        if array.dtype.kind in "iuf" and (values is array or not _has_flag(values)):
            return array.astype(np.float64, order="C")
    except Exception:  # an object may raise anything when converted
        pass
    return None


def coerce_flag(value: object, where: str, quantity: str) -> bool:
    """Return `value` as a flag.

    Raises:
        Refusal: it is not.
    """
    if not isinstance(value, _FLAGS):
        raise Refusal(where, quantity, "be True or False", repr(value))
    return bool(value)


def coerce_kind(value: object, kind: type[Kind], where: str, quantity: str, rule: str) -> Kind:
    """Return `value`, which is of a kind.

    Raises:
        Refusal: it is not; with the rule.
    """
    if not isinstance(value, kind):
        raise Refusal(where, quantity, rule, value)
    return value


def _has_flag(values: object) -> bool:
    """Whether there is a flag among numbers in lists, which NumPy takes for 0 or 1."""
    if isinstance(values, list | tuple):  # most hold floats, of which a call each takes long
        return any(type(value) is not float and _has_flag(value) for value in values)
    return isinstance(values, _FLAGS) or getattr(values, "dtype", None) == np.bool_
