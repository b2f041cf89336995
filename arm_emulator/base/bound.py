"""How large a quantity that comes from outside may be.

A finite number need not be a quantity: a joint at 1e308 rad is a mistake of its sender, and what is
computed from it overflows. So every number is compared with a bound once, where it comes in. The
bounds are far beyond every machine, and all that is computed within them is finite.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from arm_emulator.base.given import FloatArray, as_numbers
from arm_emulator.base.refusal import Refusal


class Bound:
    """The largest size of a quantity, of either sign.

    Args:
        quantity: its name, for refusals.
        unit: empty for whole numbers and shares.
        largest: one for all joints, or one per joint (N,).
    """

    def __init__(self, quantity: str, unit: str, largest: float | FloatArray) -> None:
        self.quantity = quantity
        self.unit = unit
        self.largest = largest
        self._smallest = min(float(np.min(largest)), sys.float_info.max)

    def named(self, quantity: str) -> Bound:
        """Return the same bound for a quantity of another name."""
        return Bound(quantity, self.unit, self.largest)

    def check(self, where: str, values: Sequence[float] | FloatArray) -> None:
        """Refuse values of which one is not finite or too large.

        Raises:
            Refusal: see above.
        """
        if math.hypot(*values) <= self._smallest:  # so is each of them; False of a NaN
            return
        array = np.array(values, dtype=np.float64)
        if not np.isfinite(array).all():
            raise Refusal(where, self.quantity, f"be finite{self._in_unit()}", array.tolist())
        wrong = np.flatnonzero(np.abs(array) > self.largest)
        if len(wrong):
            limit = float(np.broadcast_to(self.largest, array.shape)[wrong[0]])
            rule = f"be within +-{limit:g}{self._in_unit()}"
            raise Refusal(where, self.quantity, rule, array.tolist())

    def vector(self, where: str, values: npt.ArrayLike, count: int) -> FloatArray:
        """Return `values` as an array of `count` numbers within the bound, which may be `values`.

        Raises:
            Refusal: no numbers, another number of them, not finite, or too large.
        """
        array = self.numbers(where, values)
        if array.shape != (count,):
            raise Refusal(where, self.quantity, f"have {count} values", values)
        self.check(where, array.tolist())
        return array

    def numbers(self, where: str, values: npt.ArrayLike) -> FloatArray:
        """Return `values` as an array of numbers of any size, which may be `values` itself.

        Raises:
            Refusal: something that is no number.
        """
        return as_numbers(values, where, self.quantity, self.unit)

    def _in_unit(self) -> str:
        return f" [{self.unit}]" if self.unit else ""


# Commands to a joint and measurements of it; a joint that slides has m in place of rad.
POSITION = Bound("position", "rad", 1e6)
VELOCITY = Bound("velocity", "rad/s", 1e6)
ACCELERATION = Bound("acceleration", "rad/s2", 1e9)
EFFORT = Bound("effort", "N m", 1e9)
COMMAND = Bound("command", "V, N m or A", 1e9)
CURRENT = Bound("current", "A", 1e9)
# What acts on a link from outside, and where on it.
FORCE = Bound("force", "N", 1e6)
MOMENT = Bound("moment", "N m", 1e6)
POINT = Bound("point", "m", 1e3)
# Target of the tool, in the world.
TOOL_POSITION = Bound("position", "m", 1e6)

# Beyond, half a count is lost in the rounding of a number.
LARGEST_COUNT = 2.0**52


def encoder_counts(count_angle: npt.ArrayLike) -> Bound:
    """Return the bound of encoder counts: that of the joint's position.

    Args:
        count_angle: link angle of one count, per joint (N,) [rad or m].
    """
    with np.errstate(over="ignore", divide="ignore"):
        counts = np.floor(POSITION.largest / np.abs(np.asarray(count_angle, dtype=np.float64)))
    # One less: the position is taken as the middle of the count.
    return Bound("encoder_counts", "", np.minimum(LARGEST_COUNT, counts) - 1.0)
