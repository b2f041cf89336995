"""Permanent-magnet synchronous motors."""

from __future__ import annotations

import math
from dataclasses import dataclass

from arm_emulator.machine.parts.input import Input
from arm_emulator.machine.parts.motor import Motor, ServoData
from arm_emulator.machine.parts.output import FURTHER, Output
from arm_emulator.machine.parts.part import number


@dataclass(frozen=True, kw_only=True)
class Pmsm(Motor):
    """A permanent-magnet synchronous motor in the frame of its rotor, amplitudes of its phases."""

    kind = "pmsm"
    has_winding = True
    header = "pmsm.hpp"
    cxx = "Pmsm"
    inputs = (
        Input("command", "voltage across each rotor's flux", "V", mode="ARM_VOLTAGE_DQ"),
        Input("command_d", "voltage along each rotor's flux", "V", applied="applied_d"),
    )
    outputs = (
        Output("current_d", "current along each rotor's flux", "current_d", "A"),
        Output("applied_d", "what each motor got of command_d", FURTHER),
    )

    resistance: float = number("R", "ohm", above=0.0)
    inductance_d: float = number("Ld", "H", above=0.0)
    inductance_q: float = number("Lq", "H", above=0.0)
    flux: float = number("psi", "V s", at_least=0.0)
    pole_pairs: int = number("p", "pairs", at_least=1.0, at_most=1000.0, whole=True)
    rotor_inertia: float = number("Mm", "kg m2", above=0.0, sought="known")

    @property
    def servo_data(self) -> ServoData:
        """Across the flux it is a dc motor, but for products of currents and speed."""
        return ServoData(
            torque_constant=1.5 * self.pole_pairs * self.flux,
            resistance=self.resistance,
            inductance=self.inductance_q,
            back_emf_constant=self.pole_pairs * self.flux,
        )

    @property
    def torque_per_command(self) -> float:  # noqa: D102
        return 1.5 * self.pole_pairs * self.flux / self.resistance

    def largest_command(self, supply_voltage: float) -> float | None:  # noqa: D102
        return supply_voltage / math.sqrt(3.0)  # the amplitude that an inverter reaches

    def felt_at_link(self, ratio: float) -> dict[str, float]:  # noqa: D102
        return {
            "rotor inertia": self.rotor_inertia / ratio**2,
            "torque per current": 1.5 * self.pole_pairs * self.flux / abs(ratio),
            "voltage per speed": self.pole_pairs * self.flux / abs(ratio),
        }
