"""Equality of records whose values may be arrays."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np


class ArrayEquality:  # noqa: PLW1641  # arrays change: there is no hash
    """Base of dataclasses with arrays, which take ``eq=False``: equal if all values are.

    The equality that dataclasses generate asks an array for one truth value, and raises. A value
    that was not measured is NaN and equals itself.
    """

    def __eq__(self, other: object) -> bool:
        return _is_same(self, other) if type(other) is type(self) else NotImplemented


def _is_same(left: Any, right: Any) -> bool:
    if left is right:
        return True
    if type(left) is not type(right):
        return False
    if isinstance(left, np.ndarray):
        if left.dtype != right.dtype or left.shape != right.shape:
            return False
        names = left.dtype.names  # of a record, which NumPy compares without regard to NaN
        if names is not None:
            return all(_is_same(left[name], right[name]) for name in names)
        return np.array_equal(left, right, equal_nan=left.dtype.kind == "f")
    if dataclasses.is_dataclass(left):
        names = [field.name for field in dataclasses.fields(left) if field.compare]
        return all(_is_same(getattr(left, name), getattr(right, name)) for name in names)
    if isinstance(left, Mapping):
        return left.keys() == right.keys() and all(_is_same(left[key], right[key]) for key in left)
    if isinstance(left, tuple | list):
        return len(left) == len(right) and all(map(_is_same, left, right))
    if isinstance(left, float) and math.isnan(left):
        return math.isnan(right)
    return bool(left == right)
