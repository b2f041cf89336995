"""Gears with a linear spring and a damper."""

from typing import ClassVar

from arm_emulator.machine.parts.gears.gear import Gear
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part


@register_part
class ElasticGear(Gear):
    """A spring and a damper between the rotor, reduced, and the link."""

    header = "gears/gear.hpp"
    cxx = "ElasticGear"
    named_by: ClassVar[tuple[str, ...]] = ("stiffness",)
    is_linear: ClassVar[bool] = True

    stiffness: float = number(
        "Kg", "N m/rad", above=0.0, absent="a rigid gear", text="Kg, seen at the link"
    )
    damping: float = number(
        "Dg",
        "N m s/rad",
        at_least=0.0,
        default=0.0,
        text="Dg, seen at the link; refused without a stiffness",
    )

    def compute_wind_up(self, torque: float) -> float:  # noqa: D102
        return torque / self.stiffness
