"""Gears that stiffen as they wind up."""

import math

from arm_emulator.machine.parts.gears.elastic_gear import ElasticGear
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part


@register_part
class ProgressiveGear(ElasticGear):
    """An elastic gear whose spring has a cubic part, too."""

    header = "gears/progressive_gear.hpp"
    cxx = "ProgressiveGear"
    named_by = ("stiffness", "cubic_stiffness")
    stiffens = True
    is_linear = False

    cubic_stiffness: float = number(
        "Kg3",
        "N m/rad3",
        at_least=0.0,
        text="Kg3, seen at the link: the gear stiffens as it winds up; refused without a stiffness",
    )

    def compute_wind_up(self, torque: float) -> float:  # noqa: D102
        if not self.cubic_stiffness:
            return super().compute_wind_up(torque)
        # Kg w + Kg3 w^3 = T as 4 s^3 + 3 s = sinh(3 t), s = sinh(t): its only real root.
        scale = math.sqrt(4.0 * self.stiffness / (3.0 * self.cubic_stiffness))
        three_t = math.asinh(3.0 * torque / (self.stiffness * scale))
        return scale * math.sinh(three_t / 3.0)
