"""Numbers outside of a declared range, and the one form of refusal of every reader."""

import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.number import Number

NO_NUMBERS: tuple[Any, ...] = (
    None, "much", True, False, [1.0], math.nan, math.inf, -math.inf, 10**400,
    np.bool_(True), np.float64(math.nan), np.float32(math.inf), np.array([1.0, 2.0]),
)  # fmt: skip
RULE = re.compile(
    r"(?P<where>.+?): (?P<name>[^:]+) must be a (?P<kind>whole number|finite number|number)"
    r"(?P<range>( of size)?( other than 0| within \+-\S+| from \S+ to \S+|( and)? (>=?|<=) \S+)*)"
    r"(?P<unit> .+?)?, got (?P<got>.*)"
)
SIGNS = {">": lambda x, y: x > y, ">=": lambda x, y: x >= y, "<=": lambda x, y: x <= y}


def fits(words: str, value: float) -> bool:
    """Whether a value keeps the rule of a refusal, by reading its words."""
    is_inside = math.isfinite(value) and ("whole number" not in words or value == int(value))
    is_inside = is_inside and not ("other than 0" in words and value == 0)
    if within := re.search(r"within \+-(\S+)", words):
        is_inside = is_inside and abs(value) <= float(within[1])
    size = abs(value) if "of size" in words else value
    for sign, bound in re.findall(r"(>=|<=|>) (\S+)", words):
        is_inside = is_inside and SIGNS[sign](size, float(bound))
    if between := re.search(r"from (\S+) to (\S+)", words):
        is_inside = is_inside and float(between[1]) <= size <= float(between[2])
    return bool(is_inside)


def out_of_range(number: Number) -> list[float]:
    """Numbers beyond both ends, near and far."""
    low, high = number.ends
    beyond = [high + 1e-3 * (abs(high) or 1.0), 2.0 * abs(high) + 1.0]
    beyond += [low - 1e-3 * (abs(low) or 1.0), -2.0 * abs(low) - 1.0]
    if number.above is not None:
        beyond += [number.above, 0.5 * number.least if number.above == 0.0 else number.above - 1e-3]
    if number.whole:
        beyond += [x for x in (number.least + 0.5, number.most - 0.5) if x % 1.0]
    outside = [x for x in beyond if math.isfinite(x)]
    return [*outside, *map(np.float64, outside)]


def check_refusals(number: Number, name: str, read: Callable[[Any], object]) -> int:
    """Let a reader refuse all that is out of a number's range; return how many values it was."""
    values = [*NO_NUMBERS, *out_of_range(number)]
    for value in values:
        with pytest.raises(Refusal) as refusal:
            read(value)
            pytest.fail(f"{name}: {value!r} is taken")
        printed = str(refusal.value)
        rule = RULE.fullmatch(printed)
        assert rule is not None, f"{name}: {value!r}: {printed}"
        assert rule["name"].endswith(name), f"{name}: {printed}"
        if isinstance(value, float):
            assert not fits(f"{rule['kind']}{rule['range']}", value), f"{value!r}: {printed}"
    return len(values)
