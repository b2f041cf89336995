"""What a number may be is declared once; all that is derived from it is of one mind."""

from __future__ import annotations

import math
import re
import sys

import numpy as np

from arm_emulator.base.number import Range

SIGNS = {">": lambda x, y: x > y, ">=": lambda x, y: x >= y, "<=": lambda x, y: x <= y}
UNITS = ("", "ohm", "N m s/rad")


def drawn(rng: np.random.Generator) -> Range:
    low, high = sorted(rng.uniform(-10.0, 10.0, 2).round(1).tolist())
    whole = bool(rng.random() < 0.3)
    if whole:
        low, high = math.floor(low), math.ceil(high) + 1
    bounds = [{}, {"above": low}, {"at_least": low}, {"at_most": high},
              {"at_least": low, "at_most": high}, {"above": low, "at_most": high}]  # fmt: skip
    return Range(str(rng.choice(UNITS)), **bounds[rng.integers(len(bounds))], whole=whole)


def as_words_report(words: str, value: float, whole: bool) -> bool:
    """Whether a value fits the words of a refusal, by reading them."""
    kept = not whole or float(value).is_integer()
    for sign, bound in re.findall(r"(>=|<=|>) (-?[\d.]+)", words):
        kept = kept and SIGNS[sign](value, float(bound))
    between = re.search(r"from (-?[\d.]+) to (-?[\d.]+)", words)
    return kept and (not between or float(between[1]) <= value <= float(between[2]))


def test_words_and_range_agree() -> None:
    rng = np.random.default_rng(22)
    taken = 0
    for _ in range(400):
        one = drawn(rng)
        ends = [x for x in (one.above, one.at_least, one.at_most) if x is not None]
        near = [math.nextafter(x, to) for x in ends for to in (-math.inf, math.inf)]
        values = [*ends, *near, *rng.uniform(-15.0, 15.0, 5).tolist(), 0.0, 3, -4]
        for value in values:
            assert one.holds(value) == as_words_report(one.rule, value, one.whole), (one, value)
            taken += one.holds(value)
            if one.holds(value):
                assert one.least <= value <= one.most, (one, value)
        assert one.rule.startswith("be a whole number" if one.whole else "be a number")
        assert one.rule.endswith(one.unit) and "  " not in one.rule
        assert one.interval.endswith(f"[{one.unit}]" if one.unit else one.interval[-1])
    assert taken > 1000


def test_what_is_no_number_is_in_no_range() -> None:
    for value in (None, True, False, "1", math.nan, math.inf, -math.inf, 10**400, [1.0]):
        assert not Range().holds(value), value
    assert not Range(nonzero=True).holds(0) and Range(nonzero=True).holds(-1e-300)
    assert Range(whole=True).holds(3.0) and not Range(whole=True).holds(3.5)


def test_words_are_short() -> None:
    """As users read them."""
    assert Range("ohm", above=0).rule == "be a number > 0 ohm"
    assert Range("ohm", above=0).interval == "number in (0, inf) [ohm]"
    assert Range(at_least=0, at_most=48, whole=True).rule == "be a whole number from 0 to 48"
    assert Range(at_least=0, at_most=48, whole=True).interval == "whole number in [0, 48]"
    assert Range(nonzero=True).interval == "number other than 0"
    assert Range("s").interval == "number in (-inf, inf) [s]"
    assert (Range().least, Range().most) == (-sys.float_info.max, sys.float_info.max)
