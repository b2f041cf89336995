"""Input shaping: a motion as the sum of delayed copies that leave no vibration of known modes.

Let a mode have the frequency f [Hz] and the damping z, with w = 2 pi f and wd = w sqrt(1 - z^2).
It answers an impulse with exp(-z w t) sin(wd t). With K = exp(-z pi / sqrt(1 - z^2)) and half its
damped period H = pi / wd,

    ZV     1, K            / (1 + K)      at 0, H
    ZVD    1, 2 K, K^2     / (1 + K)^2    at 0, H, 2 H

end without vibration of that mode; after ZVD its derivative by the frequency is 0 too. (N. C.
Singer and W. P. Seering, Preshaping Command Inputs to Reduce System Vibration, ASME J. Dyn. Syst.
Meas. Control 112, 1990.) Shapers of several modes are convolved.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from arm_emulator.base.array_equality import ArrayEquality
from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.number import number
from arm_emulator.base.validation.parameters import read_numbers, split_tables

MODES = "modes"  # the section of the motion controller's parameter file
KINDS = ("none", "zv", "zvd")
MAX_MODES = 4
LONGEST = 5.0  # s of delay


@dataclass(frozen=True)
class ShapedMode:
    """A mode of the machine under its servo."""

    frequency: float = number("Hz", above=0.0, at_most=1e4, text="undamped frequency of a mode")
    damping: float = number("1", at_least=0.0, at_most=0.95, default=0.0, text="its damping ratio")


def read_modes(section: object, where: str) -> tuple[ShapedMode, ...]:
    """Return the modes of a section, by any names.

    Raises:
        Refusal: a table or number that is not taken, or too many modes.
    """
    tables: Mapping[str, Mapping[str, object]] = split_tables(section, where, MODES)
    if len(tables) > MAX_MODES:
        raise Refusal(where, MODES, f"be at most {MAX_MODES}", len(tables))
    return tuple(
        ShapedMode(**read_numbers(table, ShapedMode, where, f"{MODES}.{name}"))
        for name, table in tables.items()
    )


@dataclass(frozen=True, eq=False)
class InputShaper(ArrayEquality):
    """Impulses of a shaper.

    Attributes:
        times: (K,), rising from 0 [s].
        shares: (K,), positive, of sum 1.
    """

    times: Array
    shares: Array

    @property
    def delay(self) -> float:
        """Time by which a shaped motion ends later [s]."""
        return float(self.times[-1])

    @classmethod
    def compute_shaper(cls, kind: str, modes: Sequence[ShapedMode]) -> Self:
        """Return the shaper of a kind for some modes; without any it changes nothing."""
        times, shares = np.zeros(1), np.ones(1)
        for mode in modes if kind != "none" else ():
            root = math.sqrt(1.0 - mode.damping**2)
            half = 0.5 / (mode.frequency * root)
            K = math.exp(-math.pi * mode.damping / root)
            for _ in range(KINDS.index(kind)):  # ZVD is ZV twice
                times = np.concatenate([times, times + half])
                shares = np.concatenate([shares, K * shares]) / (1.0 + K)
        times, places = np.unique(times, return_inverse=True)
        return cls(times, np.bincount(places, shares).astype(np.float64))


def check_shaper(kind: str, modes: Sequence[ShapedMode], method: str, where: str) -> None:
    """Refuse a shaper without modes, with eq. (6), whose loop it would delay, or of long delay."""
    if kind == "none":
        return
    if not modes:
        valid = f"a section `{MODES}` of frequencies and dampings (`arm_emulator bode --closed`)"
        raise Refusal(where, "parameter shaper", "come with modes", f"{kind!r} alone", valid)
    if method == "paper":
        raise Refusal(where, "parameter shaper", "be none with the method paper", repr(kind))
    delay = InputShaper.compute_shaper(kind, modes).delay
    if delay > LONGEST:
        rule = f"be of frequencies that delay a motion by at most {LONGEST:g} s"
        raise Refusal(where, MODES, rule, f"{delay:.3g} s")
