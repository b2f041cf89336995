"""Torque ripple of motors."""

from typing import Any

from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.drive_stages.drive_stage import DriveStage, Supply
from arm_emulator.machine.parts.motors.motor import CxxMotor, Motor
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
class TorqueRipple(DriveStage):
    """A motor's torque per current varies with the angle of its rotor."""

    section = "motor.ripple"
    layer = 3
    hides = "phase_lost"
    electrical = False
    header = "drive_stages/torque_ripple.hpp"
    cxx = "RippledMotor"
    keys = (
        declare_waves(
            "waves",
            "1",
            "amplitudes that sum up to 0.9 at most",
            "waves per turn of the motor, share of the torque, phase",
        ),
    )

    waves: tuple[Wave, ...] = ()  # of 1

    def compute_effort(self, motion: ShaftMotion) -> Array:
        """The torque that the ripple takes from the motor's."""
        torque: Array = -compute_wave_sum(self.waves, motion.angle) * motion.motor_torque
        return torque

    @classmethod
    def read_numbers(cls, section: Section) -> dict[str, Any]:  # noqa: D102
        return {"waves": read_waves(section, "waves", "1")}

    def check_numbers(self, section: Section) -> None:  # noqa: D102
        # More would turn the torque about at some angles.
        amplitude_sum = sum(abs(amplitude) for _, amplitude, _ in self.waves)
        if amplitude_sum > 0.9:
            raise section.make_refusal(
                "waves", "have amplitudes that sum up to at most 0.9", amplitude_sum
            )

    def check_motor(self, motor: Motor, joint: Section) -> None:  # noqa: D102
        if motor.has_algebraic_current:
            rule = "come with an inductance: the current would follow each wave at once"
            raise joint.make_refusal(self.section, rule, "none")

    def wrap_motor(self, motor: Motor, inner: CxxMotor, own: str, supply: Supply) -> CxxMotor:  # noqa: D102
        if not self.waves:
            return inner
        kind = f"arm::{self.cxx}<{inner.type}, {len(self.waves)}>"
        return CxxMotor(kind, f"{kind}{{{inner.value}, {write_waves(self.waves)}}}")
