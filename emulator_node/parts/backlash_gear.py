"""Gears with play."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated

from emulator_node.parts.elastic_gear import ElasticGear
from emulator_node.parts.part import Number


@dataclass(frozen=True, kw_only=True)
class BacklashGear(ElasticGear):
    """An elastic gear whose teeth touch nothing in the middle of its play."""

    header = "backlash.hpp"
    cxx = "BacklashGear"
    told_by = ("stiffness", "backlash")

    # By so much the link turns with the motor held.
    backlash: Annotated[float, Number("play", "rad", at_least=0.0)] = field()

    def wind_up(self, torque: float) -> float:
        """Return the angle by which the gear gives way at rest, the play included."""
        free = math.copysign(0.5 * self.backlash, torque) if torque else 0.0
        return free + super().wind_up(torque)
