"""Base of methods that reach rare failures level by level, several times, for an interval."""

from __future__ import annotations

from dataclasses import dataclass

from arm_emulator.base.number import number
from arm_emulator.campaign.search.method import Method


@dataclass(frozen=True, kw_only=True)
class ByLevels(Method):
    """A method that multiplies the shares of runs that reach each next level."""

    repetitions: float = number(
        ends=(4, 1000), whole=True, default=10, text="independent ones, for the interval"
    )
    confidence: float = number(above=0.5, at_most=0.999999, default=0.95, text="of the interval")
    least: float = number(
        above=0.0, at_most=0.1, default=1e-12, text="probability below which it gives up"
    )
