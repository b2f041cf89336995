"""The temperature of gears and their grease."""

from collections.abc import Sequence

from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.drive_stages.winding import Winding, declare_temperature
from arm_emulator.machine.parts.fault import Fault, bound_rise, declare_rise
from arm_emulator.machine.parts.joint_effects.joint_effect import JointEffect
from arm_emulator.machine.parts.output import Output
from arm_emulator.machine.parts.part import Part, number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion


@register_part
class GearTemperature(JointEffect):
    """Friction heats the gear, and follows its temperature."""

    section = "gear.thermal"
    header = "joint_effects/gear_temperature.hpp"
    cxx = "GearTemperature"
    friction_wrapper = "Warm"
    truths = (
        Output("gear_temperature", "true temperature of the gear", "gear_temperature", "degC"),
    )

    heat_capacity: float = number("C", "J/K", above=0.0, text="C, of gear and grease")
    thermal_resistance: float = number(
        "Rth", "K/W", above=0.0, text="Rth, from the gear to the ambient"
    )
    ambient: float = declare_temperature(
        "ambient", "temperature around the joint, at which it starts"
    )
    reference: float = declare_temperature(
        "reference", "Tref, at which the numbers of friction hold"
    )
    viscous_floor: float = number(
        "r", "1", ends=(0.0, 1.0), default=0.0, text="r, the share of viscous friction left in heat"
    )
    viscous_decay: float = number(
        "Tv",
        "K",
        ends=(5.0, 1e4),
        default=None,
        absent="constant viscous friction",
        text="Tv, by which viscous friction falls to 37 %",
    )
    dry_coefficient: float = number(
        "c",
        "1/K",
        ends=(-0.02, 0.02),
        default=0.0,
        text="c, of dry and load friction",
    )
    winding_resistance: float = number(
        "Rw",
        "K/W",
        above=0.0,
        default=None,
        absent="no heat from the winding",
        text="Rw, from the winding (`motor.winding`) to the gear",
    )

    def compute_effort(self, motion: ShaftMotion) -> Array | None:
        """None: the motion of now does not determine the temperature."""
        return None

    def check_parts(self, parts: Sequence[Part], joint: Section) -> None:  # noqa: D102
        heated = any(isinstance(part, Winding) for part in parts)
        if self.winding_resistance is not None and not heated:
            rule = "come with motor.winding, whose temperature it takes"
            raise joint.make_refusal(f"{self.section}.winding_resistance", rule, "none")

    @classmethod
    def list_faults(cls) -> tuple[Fault, ...]:  # noqa: D102
        return (
            Fault(
                "air_around_gear_warms",
                "the air around the gear is warmer, or colder by a negative number",
                sets=declare_rise("gear.thermal.ambient"),
                magnitude=bound_rise("K", 20.0, 100.0, signed=True),
            ),
        )
