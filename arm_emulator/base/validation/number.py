"""Numbers that come from outside, each declared once: name, unit, range, default, what it is.

Readers of files, checks of commands, refusals, the descriptors of ROS parameters and the ranges in
the pages follow from the declaration. It stands in a dataclass that has the number::

    boot: float = number("s", at_least=0.0, at_most=100.0, default=0.0)

or by itself: ``POSITION = Number.bound_size("position", "rad", 1e6)``.
"""

import dataclasses
import math
import numbers
import sys
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from functools import cache, cached_property
from typing import Any, Self

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.coerce import coerce_array

# A finite number need not be a quantity. What lies beyond these is a slip, and what is computed
# from several such numbers may overflow. They hold where no other bound is declared.
SMALLEST, LARGEST = 1e-15, 1e15  # of numbers above 0, and of all
FEW = 64  # numbers of a row that are looked at as a list

REQUIRED = ...  # the default of a number that must be given


@dataclass(frozen=True)
class Number:
    """Name, unit, range, default and text of a number.

    Attributes:
        name: its key or attribute, which refusals name.
        unit: empty or 1 for shares, counts and factors.
        above: the number is larger.
        at_least, at_most: the number is within; `at_most` of a row may be one per entry (N,).
        in_size: whether the bounds are those of the number's size, and it may be negative.
        whole: whether it is a whole number.
        default: what stands for a number that is not given, `REQUIRED` if it must be.
        text: what it is, in a line.
    """

    name: str = ""
    unit: str = ""
    _: KW_ONLY
    above: float | None = None
    at_least: float | None = None
    at_most: float | Array | None = None
    in_size: bool = False
    whole: bool = False
    default: Any = REQUIRED
    text: str = ""

    @classmethod
    def bound_size(cls, name: str, unit: str, largest: float | Array) -> Self:
        """Return a number of either sign and at most this size, of a row one per entry (N,)."""
        return cls(name, unit, in_size=True, at_most=largest)

    def rename(self, name: str) -> Self:
        """Return the same for a quantity of another name."""
        renamed = object.__new__(type(self))  # all but the name: quicker than dataclasses.replace
        renamed.__dict__.update(self.__dict__, name=name)
        return renamed

    def is_in_range(self, value: object) -> bool:
        """Whether a value is a finite number within the range."""
        if type(value) is not float:  # most are, and the abstract class takes long to ask
            if isinstance(value, bool) or not isinstance(value, numbers.Real):
                return False
            if isinstance(value, np.floating):  # short ones cannot hold the ends of ranges
                value = float(value)
        size: Any = abs(value) if self.in_size else value
        within = self.least <= size <= self.most and size < math.inf
        return bool(within and not (self.whole and size % 1))

    def check_value(self, where: str, value: Any, name: str = "") -> float:
        """Return a value as a float, or as an int where it is a whole number.

        Args:
            where: for refusals.
            value: a number, of Python or NumPy.
            name: for refusals, where it is not the declared one.

        Raises:
            Refusal: it is no number, not finite, or out of the range.
        """
        if isinstance(value, np.ndarray) and value.ndim == 0:
            value = value[()]
        if not self.is_in_range(value):
            raise self.rename(name or self.name).make_refusal(where, value)
        return int(value) if self.whole else float(value)

    def check_row(self, where: str, values: object, count: int) -> Array:
        """Return `values` as an array of `count` numbers in the range, which may be `values`.

        Raises:
            Refusal: no numbers, another number of them, not finite, or out of the range.
        """
        array = self.check_numbers(where, values)
        if array.shape != (count,):
            raise Refusal(where, self.name, f"have {count} values", values)
        self.check_values(where, array.tolist())
        return array

    def check_numbers(self, where: str, values: object) -> Array:
        """Return `values` as an array of numbers of any size, which may be `values` itself.

        Raises:
            Refusal: something that is no number.
        """
        array = coerce_array(values)
        if array is None:
            raise Refusal(where, self.name, self._describe_rule(None, self.most, many=True), values)
        return array

    def check_values(
        self, where: str, values: Sequence[float] | Array, joints: Sequence[str] = ()
    ) -> None:
        """Refuse numbers of which one is not finite or out of the range.

        Args:
            where: name of the refusal.
            values: the numbers.
            joints: names of the joints that they belong to; then a refusal names the joint.
        """
        # Each is smaller than the root of the sum of their squares; False of a NaN. Of few numbers
        # Python finds it sooner.
        few = isinstance(values, np.ndarray) and values.ndim == 1 and len(values) <= FEW
        row = values.tolist() if few else values  # type: ignore[union-attr]
        if isinstance(row, list) and math.hypot(*row) <= self._reach:
            return
        array = np.asarray(values, np.float64)
        if 0.0 <= self._reach and np.vdot(array, array) < self._reach * self._reach:
            return
        size = np.abs(array) if self.in_size else array
        largest = LARGEST if self.at_most is None else self.at_most
        wrong = ~(np.isfinite(size) & (size >= self.least) & (size <= largest))
        if self.whole:
            wrong |= np.floor(size) != size
        if wrong.any():
            at = np.unravel_index(int(wrong.argmax()), array.shape)
            limit = float(np.broadcast_to(np.asarray(largest), array.shape)[at])
            if joints:
                value = float(array[at])
                rule = self._describe_rule(value, limit) if math.isfinite(value) else "be finite"
                raise Refusal(where, f"{self.name} of {joints[int(at[0])]}", rule, value)
            actual = array.tolist() if array.ndim == 1 else array
            raise Refusal(
                where, self.name, self._describe_rule(float(array[at]), limit, many=True), actual
            )

    def make_refusal(self, where: str, value: object) -> Refusal:
        """Return the refusal of a value."""
        number = isinstance(value, int | float) and not isinstance(value, bool)
        actual = value if number else "nothing" if value is None else repr(value)
        return Refusal(where, self.name, self._describe_rule(value, self.most), actual)

    @property
    def rule(self) -> str:
        """Rule of its refusals: ``be a number > 0 ohm``."""
        return f"be a {self.range}"

    @property
    def range(self) -> str:
        """The same as a description: ``number > 0 ohm``."""
        largest = None if self.at_most is None else self.most
        return self._describe_range(self.above, self.at_least, largest)

    @property
    def described(self) -> str:
        """Description with range, in a line."""
        return f"{self.text or self.name.replace('_', ' ')} ({self.range})"

    @cached_property
    def least(self) -> float:
        """The smallest number of the range, or the smallest size."""
        if self.above is not None:
            return math.nextafter(self.above, math.inf) if self.above else SMALLEST
        if self.at_least is not None:
            return self.at_least
        return 0.0 if self.in_size else -LARGEST

    @cached_property
    def most(self) -> float:
        """The largest number; of a row, one that all its entries may have."""
        return LARGEST if self.at_most is None else float(np.min(self.at_most))

    @property
    def ends(self) -> tuple[float, float]:
        """The smallest and the largest number."""
        return (-self.most if self.in_size else self.least), self.most

    @cached_property
    def _reach(self) -> float:
        """Largest size up to which all numbers of either sign are in the range; < 0: none."""
        free = (self.least <= 0.0 if self.in_size else self.least <= -self.most) and not self.whole
        return min(self.most, sys.float_info.max) if free else -1.0

    def _describe_rule(self, value: object, largest: float, *, many: bool = False) -> str:
        """Return the rule that a value breaks: as declared, or of what can be computed with."""
        maximum = None if self.at_most is None else largest
        if isinstance(value, np.floating):
            value = float(value)
        is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
        if is_number and self._is_in_bounds(abs(value) if self.in_size else value, maximum):  # type: ignore[arg-type]
            low = None if self.in_size and self.above is None else self.least
            words = self._describe_range(None, low, largest)
        else:
            words = self._describe_range(self.above, self.at_least, maximum)
        return f"be {words.replace('number', 'numbers', 1)}" if many else f"be a {words}"

    def _is_in_bounds(self, size: float, largest: float | None) -> bool:
        return (
            (self.above is None or size > self.above)
            and (self.at_least is None or size >= self.at_least)
            and (largest is None or size <= largest)
            and not (self.whole and abs(size) < math.inf and size % 1)
        )

    def _describe_range(
        self, above: float | None, minimum: float | None, maximum: float | None
    ) -> str:
        kind = "whole number" if self.whole else "number"
        bounds = {">": above, ">=": minimum, "<=": maximum}
        phrases = [
            f"{sign} {self._write_end(end)}" for sign, end in bounds.items() if end is not None
        ]
        if maximum == math.inf:
            kind, phrases = "finite number", phrases[:-1]
        if minimum is not None and maximum is not None:
            phrases = [f"from {self._write_end(minimum)} to {self._write_end(maximum)}"]
        of_size = "of size" if self.in_size and phrases else ""
        if self.in_size and above == 0.0 and maximum is None:
            of_size, phrases = "", ["other than 0"]
        elif self.in_size and above is None and minimum is None and phrases:
            of_size, phrases = "", [f"within +-{self._write_end(maximum)}"]  # type: ignore[arg-type]
        unit = "" if self.unit == "1" else self.unit
        unit = f"[{unit}]" if unit and not phrases else unit
        words = kind, of_size, " and ".join(phrases), unit
        return " ".join(word for word in words if word)

    def _write_end(self, value: float) -> str:
        return str(int(value)) if self.whole else f"{value:g}"


Ends = tuple[float | None, float | None]


def number(
    unit: str = "", *, default: Any = REQUIRED, ends: Ends = (None, None), **declared: Any
) -> Any:
    """Return a dataclass field that is a declared number, see `Number`; `ends`: both bounds."""
    return declare_field(Number("", unit, default=default, **build_bounds(ends), **declared))


def build_bounds(ends: Ends) -> dict[str, Any]:
    """Return two ends as the bounds of a `Number`."""
    bounds = zip(("at_least", "at_most"), ends, strict=True)
    return {name: end for name, end in bounds if end is not None}


def declare_field(number: Number, **metadata: Any) -> Any:
    """Return a dataclass field for a number, with more about it."""
    default = dataclasses.MISSING if number.default is REQUIRED else number.default
    return dataclasses.field(default=default, metadata={"number": number, **metadata})


def list_numbers(kind: type[Any]) -> dict[str, Any]:
    """Return the declared numbers of a dataclass by the names of its attributes."""
    this: type = kind  # mypy takes a type[Any] for not hashable
    return _list_numbers(this)


@cache  # a scene asks once for every part of every joint
def _list_numbers(kind: type) -> dict[str, Any]:
    return {
        field.name: field.metadata["number"].rename(field.name)
        for field in dataclasses.fields(kind)
        if "number" in field.metadata
    }
