"""Gears with errors of their teeth."""

from collections.abc import Mapping
from typing import Any, ClassVar

from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.gears.elastic_gear import ElasticGear
from arm_emulator.machine.parts.key import Key
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion
from arm_emulator.machine.parts.waves import (
    MAX_WAVES,
    Wave,
    compute_wave_slope,
    read_waves,
    write_waves,
)


@register_part
class KinematicErrorGear(ElasticGear):
    """An elastic gear whose twist has an error that depends on both angles."""

    header = "gears/kinematic_error.hpp"
    cxx = "KinematicErrorGear"
    named_by: ClassVar[tuple[str, ...]] = ("stiffness", "kinematic_error")
    is_linear: ClassVar[bool] = False

    keys = tuple(
        Key(
            f"kinematic_error.{shaft}",
            unit=f"1{slide}, rad (m), rad",
            range=f"at most {MAX_WAVES} waves",
            text=f"waves [order, amplitude at the link, phase] of the {shaft}'s angle",
        )
        for shaft, slide in (("motor", ""), ("link", " (1/m)"))
    )

    motor: tuple[Wave, ...] = ()
    link: tuple[Wave, ...] = ()

    def compute_effort(self, motion: ShaftMotion) -> Array:
        """Torque on the rotor from the gear's torque, beside that by the nominal ratio."""
        by_motor = compute_wave_slope(self.motor, motion.angle) / self.ratio
        by_link = compute_wave_slope(self.link, motion.angle * self.ratio)
        torque: Array = motion.gear_torque * ((1.0 + by_motor) / (1.0 - by_link) - 1.0)
        return torque

    @classmethod
    def read_numbers(cls, section: Section) -> dict[str, Any]:  # noqa: D102
        values = super().read_numbers(section)
        if (errors := section.get_section("kinematic_error")) is not None:
            values |= {shaft: read_waves(errors, shaft, "rad") for shaft in ("motor", "link")}
        return values

    def check_numbers(self, section: Section) -> None:  # noqa: D102
        # A steeper error would turn the gear back at some angles.
        for shaft, limit in (("motor", abs(self.ratio)), ("link", 1.0)):
            waves: tuple[Wave, ...] = getattr(self, shaft)
            steepest = sum(abs(order * amplitude) for order, amplitude, _ in waves)
            if steepest > 0.9 * limit:
                rule = f"have order times amplitude sum up to at most {0.9 * limit:g}"
                raise section.make_refusal(f"kinematic_error.{shaft}", rule, f"{steepest:g}")

    @property
    def cxx_type(self) -> str:  # noqa: D102
        return f"arm::{self.cxx}<{len(self.motor)}, {len(self.link)}>"

    def list_members(self, joint: str, places: Mapping[str, str]) -> list[tuple[str, str]]:  # noqa: D102
        waves = [
            (shaft, write_waves(getattr(self, shaft)))
            for shaft in ("motor", "link")
            if getattr(self, shaft)
        ]
        return super().list_members(joint, places) + waves
