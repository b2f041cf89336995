"""Gears with a linear spring and a damper."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar

from arm_emulator.machine.parts.gear import Gear
from arm_emulator.machine.parts.part import Number


@dataclass(frozen=True, kw_only=True)
class ElasticGear(Gear):
    """A spring and a damper between the rotor, reduced, and the link."""

    header = "gear.hpp"
    cxx = "ElasticGear"
    named_by: ClassVar[tuple[str, ...]] = ("stiffness",)

    stiffness: Annotated[float, Number("Kg", "N m/rad", above=0.0)] = field()
    damping: Annotated[float, Number("Dg", "N m s/rad", at_least=0.0)] = 0.0

    def wind_up(self, torque: float) -> float:  # noqa: D102
        return torque / self.stiffness
