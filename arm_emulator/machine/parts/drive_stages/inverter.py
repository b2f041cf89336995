"""Voltage that the inverter of a drive loses."""

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.machine.parts.drive_stages.drive_stage import DriveStage, Supply
from arm_emulator.machine.parts.fault import GROWS, Fault, bound_rise
from arm_emulator.machine.parts.motors.motor import CxxMotor, Motor
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion


@register_part
class Inverter(DriveStage):
    """Dead time and transistors take a voltage along the current."""

    section = "motor.inverter"
    layer = 4
    needs_circuit = True
    header = "drive_stages/inverter.hpp"
    cxx = "Inverter"

    voltage_error: float = number("U", "V", at_least=0.0, text="U, lost along the current")
    knee: float = number("knee", "A", above=0.0, text="current at which 0.71 U are lost")

    def compute_effort(self, motion: ShaftMotion) -> Array:
        """None: measured torques are those behind it."""
        return np.zeros_like(motion.t)

    @classmethod
    def list_faults(cls) -> tuple[Fault, ...]:  # noqa: D102
        text = "the inverter's transistors switch later or conduct worse"
        sets = {"motor.inverter.voltage_error": GROWS}
        return (Fault("inverter_ages", text, sets=sets, magnitude=bound_rise("1", 1.0, 1e3)),)

    def wrap_motor(self, motor: Motor, inner: CxxMotor, own: str, supply: Supply) -> CxxMotor:  # noqa: D102
        kind = f"arm::InvertedMotor<{inner.type}>"
        return CxxMotor(kind, f"{kind}{{{inner.value}, {own}}}")
