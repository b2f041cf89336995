"""A number that comes from outside, declared once: its unit, and what it may be.

Readers of files, refusals and the descriptors of ROS parameters follow from the declaration.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass


@dataclass(frozen=True)
class Range:
    """Unit, range and text of a number.

    Attributes:
        unit: empty for shares, counts and factors.
        above: the number is larger.
        at_least, at_most: the number is within.
        whole: it is a whole number.
        nonzero: it is not 0.
    """

    unit: str = ""
    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    whole: bool = False
    nonzero: bool = False

    def holds(self, value: object) -> bool:
        """Whether a value is a finite number within the range."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            return False
        try:
            number = float(value)
        except OverflowError:  # a whole number that is too large for one
            return False
        return (
            math.isfinite(number)
            and (self.above is None or value > self.above)
            and (self.at_least is None or value >= self.at_least)
            and (self.at_most is None or value <= self.at_most)
            and not (self.whole and not number.is_integer())
            and not (self.nonzero and value == 0.0)
        )

    @property
    def rule(self) -> str:
        """What a refusal of it demands: ``be a number > 0 ohm``."""
        bounds = []
        if self.nonzero:
            bounds.append("other than 0")
        if self.at_least is not None and self.at_most is not None:
            bounds.append(f"from {self.at_least} to {self.at_most}")
        else:
            signs = {">": self.above, ">=": self.at_least, "<=": self.at_most}
            bounds += [f"{sign} {one}" for sign, one in signs.items() if one is not None]
        words = "be a", self._kind, " and ".join(bounds), self.unit
        return " ".join(word for word in words if word)

    @property
    def interval(self) -> str:
        """The same in short: ``number in (0, inf) [ohm]``."""
        unit = f" [{self.unit}]" if self.unit else ""
        if self.nonzero:
            return f"{self._kind} other than 0{unit}"
        first = "(-inf" if self.at_least is None else f"[{self.at_least}"
        first = first if self.above is None else f"({self.above}"
        last = "inf)" if self.at_most is None else f"{self.at_most}]"
        return f"{self._kind} in {first}, {last}{unit}"

    @property
    def least(self) -> float:
        """The smallest number of the range, for those who ask for numbers."""
        if self.above is not None:
            return math.nextafter(self.above, math.inf)
        return -sys.float_info.max if self.at_least is None else self.at_least

    @property
    def most(self) -> float:
        """The largest."""
        return sys.float_info.max if self.at_most is None else self.at_most

    @property
    def _kind(self) -> str:
        return "whole number" if self.whole else "number"
