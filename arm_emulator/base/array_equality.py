"""Equality of records whose values may be arrays."""

from __future__ import annotations

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


def _is_same(one: Any, other: Any) -> bool:
    if one is other:
        return True
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        if one.dtype != other.dtype or one.shape != other.shape:
            return False
        names = one.dtype.names  # of a record, which NumPy compares without regard to NaN
        if names is not None:
            return all(_is_same(one[name], other[name]) for name in names)
        return np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    if dataclasses.is_dataclass(one):
        names = [field.name for field in dataclasses.fields(one) if field.compare]
        return all(_is_same(getattr(one, name), getattr(other, name)) for name in names)
    if isinstance(one, Mapping):
        return one.keys() == other.keys() and all(_is_same(one[key], other[key]) for key in one)
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(_is_same, one, other))
    if isinstance(one, float) and math.isnan(one):
        return math.isnan(other)
    return bool(one == other)
