"""Stops at the ends of a joint's way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from emulator_node.parts.part import Number, Part
from emulator_node.section import Section


@dataclass(frozen=True, kw_only=True)
class EndStops(Part):
    """A spring and a damper at each end that push the link back and never hold it."""

    section = "end_stops"
    header = "end_stops.hpp"
    cxx = "EndStops"

    lower: Annotated[float, Number("lower", "rad", at_least=-1e4, at_most=1e4)]
    upper: Annotated[float, Number("upper", "rad", at_least=-1e4, at_most=1e4)]
    stiffness: Annotated[float, Number("K", "N m/rad", above=0.0)]
    damping: Annotated[float, Number("D", "N m s/rad", at_least=0.0)] = 0.0

    def check(self, section: Section) -> None:  # noqa: D102
        if self.lower >= self.upper:
            rule = f"be > {self.lower:g} rad, the lower one"
            raise section.refusal("upper", rule, self.upper)
