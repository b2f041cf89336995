"""Torque ripple of motors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from arm_emulator.base.section import Section
from arm_emulator.machine.chain import Array
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.parts.resting import AtRest, Share
from arm_emulator.machine.parts.shaft_motion import ShaftMotion
from arm_emulator.machine.parts.waves import Wave, cxx_waves, read_waves, wave_sum


@dataclass(frozen=True, kw_only=True)
class TorqueRipple(Part):
    """What a motor makes of its current goes with the angle of its rotor."""

    section = "motor.ripple"
    shaft = "rotor"
    header = "torque_ripple.hpp"
    cxx = "RippledMotor"

    waves: tuple[Wave, ...] = ()  # of 1

    def effort(self, motion: ShaftMotion) -> Array:
        """What the motor gives less than its constants say."""
        torque: Array = -wave_sum(self.waves, motion.angle) * motion.motor_torque
        return torque

    @classmethod
    def read_numbers(cls, section: Section) -> dict[str, Any]:  # noqa: D102
        return {"waves": read_waves(section, "waves", "1")}

    def rests(self, at: AtRest) -> Share | str:
        """What stands still is taken up by the servo's integral."""
        return Share()

    def check(self, section: Section) -> None:  # noqa: D102
        # More would turn the torque about at some angles.
        most = sum(abs(amplitude) for _, amplitude, _ in self.waves)
        if most > 0.9:
            raise section.refusal("waves", "have amplitudes that sum up to at most 0.9", most)

    def around_type(self, motor: str) -> str:
        """Return the C++ type of a motor with it."""
        return f"arm::{self.cxx}<{motor}, {len(self.waves)}>" if self.waves else motor

    def around(self, motor_type: str, motor: str) -> str:
        """Return a motor with it in C++."""
        if not self.waves:
            return motor
        return f"{self.around_type(motor_type)}{{{motor}, {cxx_waves(self.waves)}}}"
