"""Numbers, flags and rows of numbers as callers give them: Python's, or NumPy's of any width.

``True`` is no number and 1 is no flag, wherever they stand.
"""

from __future__ import annotations

import numbers

import numpy as np
import numpy.typing as npt

from arm_emulator.base.refusal import Refusal

FloatArray = npt.NDArray[np.float64]

_FLAGS = (bool, np.bool_)


def as_numbers(values: object, where: str, quantity: str, unit: str = "") -> FloatArray:
    """Return `values` as an array of numbers in rows; a copy only where they are something else.

    Raises:
        Refusal: something in it is no real number.
    """
    if isinstance(values, np.ndarray) and values.dtype == np.float64 and values.flags.c_contiguous:
        return values
    try:
        array = np.asarray(values)
        if array.dtype.kind in "iuf" and (values is array or not _holds_flag(values)):
            return array.astype(np.float64, order="C")
    except Exception:  # whatever an object does that is asked for its numbers, it has none
        pass
    raise Refusal(where, quantity, f"be numbers{_in(unit)}", values) from None


def as_row(values: object, count: int, where: str, quantity: str, unit: str = "") -> FloatArray:
    """Return `values` as `count` finite numbers, see `as_numbers`.

    Raises:
        Refusal: see above.
    """
    row = as_numbers(values, where, quantity, unit)
    if row.shape != (count,):
        raise Refusal(where, quantity, f"have shape ({count},)", row.shape)
    if not np.isfinite(row).all():
        raise Refusal(where, quantity, f"be finite{_in(unit)}", row)
    return row


def as_number(value: object, where: str, quantity: str, least: float, most: float) -> float:
    """Return `value` as a number from `least` to `most`.

    Raises:
        Refusal: see above.
    """
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    sound = isinstance(value, numbers.Real) and not isinstance(value, _FLAGS)
    try:
        number = float(value) if sound else float("nan")  # type: ignore[arg-type]
    except OverflowError:
        number = float("inf")
    if not least <= number <= most:
        raise Refusal(where, quantity, f"be a number from {least:g} to {most:g}", value)
    return number


def as_flag(value: object, where: str, quantity: str) -> bool:
    """Return `value` as a flag.

    Raises:
        Refusal: it is not.
    """
    if not isinstance(value, _FLAGS):
        raise Refusal(where, quantity, "be True or False", repr(value))
    return bool(value)


def _holds_flag(values: object) -> bool:
    """Whether there is a flag among numbers in lists, which NumPy takes for 0 or 1."""
    if isinstance(values, list | tuple):
        return any(map(_holds_flag, values))
    return isinstance(values, _FLAGS) or getattr(values, "dtype", None) == np.bool_


def _in(unit: str) -> str:
    return f" [{unit}]" if unit else ""
