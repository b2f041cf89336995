"""Gears with play."""

import math

from arm_emulator.machine.parts.fault import Fault, bound_rise, declare_rise
from arm_emulator.machine.parts.gears.elastic_gear import ElasticGear
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part


@register_part
class BacklashGear(ElasticGear):
    """An elastic gear whose teeth do not touch within its play."""

    header = "gears/backlash.hpp"
    cxx = "BacklashGear"
    named_by = ("stiffness", "backlash")
    has_play = True
    is_linear = False

    # Free play of the link with the motor held.
    backlash: float = number(
        "play", "rad", at_least=0.0, text="free play of the link while the motor is held"
    )

    @classmethod
    def list_faults(cls) -> tuple[Fault, ...]:  # noqa: D102
        return (
            Fault(
                "backlash_grows",
                "the teeth wear, and the gear's play grows",
                sets=declare_rise("gear.backlash"),
                magnitude=bound_rise("rad", 1e-3, 1.0),
            ),
        )

    def compute_wind_up(self, torque: float) -> float:
        """Return the gear's wind-up at rest, with the play."""
        free = math.copysign(0.5 * self.backlash, torque) if torque else 0.0
        return free + super().compute_wind_up(torque)
