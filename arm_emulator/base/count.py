"""Counts that come from outside: whole numbers that fit."""

from __future__ import annotations

import numpy as np

from arm_emulator.base.refusal import Refusal

LARGEST = 2**63 - 1  # what the core counts with


def check_count(
    where: str, quantity: str, value: int, least: int = 0, largest: int = LARGEST
) -> None:
    """Raise unless a value is a whole number from `least` to `largest`.

    Raises:
        Refusal: see above.
    """
    if not isinstance(value, int | np.integer) or isinstance(value, bool):
        raise Refusal(where, quantity, "be a whole number", repr(value))
    if value < least:
        raise Refusal(where, quantity, f"be >= {least}", value)
    if value > largest:
        raise Refusal(where, quantity, f"be at most {largest:g}", value)
