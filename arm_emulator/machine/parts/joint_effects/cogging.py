"""Cogging of motors."""

from collections.abc import Mapping
from typing import Any

from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.joint_effects.joint_effect import JointEffect
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion
from arm_emulator.machine.parts.waves import (
    Wave,
    compute_wave_sum,
    declare_waves,
    read_waves,
    write_waves,
)


@register_part
class Cogging(JointEffect):
    """Attraction of the magnets by the stator's teeth, with or without current."""

    section = "motor.cogging"
    rank = 4
    of_angle = True
    shaft = "rotor"
    header = "joint_effects/cogging.hpp"
    cxx = "Cogging"
    keys = (
        declare_waves("waves", "N m", "a ±1e3", "waves per turn of the motor, amplitude, phase"),
    )

    waves: tuple[Wave, ...] = ()  # N m

    def compute_effort(self, motion: ShaftMotion) -> Array:  # noqa: D102
        return compute_wave_sum(self.waves, motion.angle)

    @classmethod
    def read_numbers(cls, section: Section) -> dict[str, Any]:  # noqa: D102
        return {"waves": read_waves(section, "waves", "N m")}

    @property
    def cxx_type(self) -> str:  # noqa: D102
        return f"arm::{self.cxx}<{len(self.waves)}>"

    def list_members(self, joint: str, places: Mapping[str, str]) -> list[tuple[str, str]]:  # noqa: D102
        return [("waves", write_waves(self.waves))] if self.waves else []
