"""Permanent-magnet synchronous motors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

from arm_emulator.base.section import Section
from arm_emulator.machine.parts.drawn import Numbers, Rng, scaled
from arm_emulator.machine.parts.input import Input
from arm_emulator.machine.parts.motor import Circuit, Motor, Rating, ServoData
from arm_emulator.machine.parts.output import FURTHER, Output
from arm_emulator.machine.parts.part import number

AMPLITUDE = math.sqrt(3.0)  # of the supply to the largest that an inverter makes of it
POLE_PAIRS = 4  # of servo motors, where none are given


@dataclass(frozen=True, kw_only=True)
class Pmsm(Motor):
    """A permanent-magnet synchronous motor in the frame of its rotor, amplitudes of its phases."""

    kind = "pmsm"
    has_winding = True
    limit = "current_limit"
    rules = (
        "three phases at supply / sqrt(3): back EMF 60 % of it at full speed, 25 % for the winding",
        "at peak torque, L/R 1 ms; current of the peak torque; drives that sample at 16 kHz",
    )
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
    current_limit: float | None = number("current_limit", "A", above=0.0, default=None)

    def check(self, section: Section) -> None:  # noqa: D102
        if self.current_limit is not None and not section.has("current_loop"):
            rule = "come with a current_loop, whose commands it bounds"
            raise section.refusal("current_limit", rule, self.current_limit)

    @classmethod
    def sized(cls, rating: Rating) -> Self:
        """As a dc motor at the inverter's voltage."""
        flux = rating.back_emf_constant / AMPLITUDE / POLE_PAIRS
        resistance = 1.5 * rating.resistance / AMPLITUDE**2
        inductance = resistance * rating.inductance / rating.resistance
        return cls(
            resistance=resistance,
            inductance_d=inductance,
            inductance_q=inductance,
            flux=flux,
            pole_pairs=POLE_PAIRS,
            rotor_inertia=rating.rotor_inertia,
            current_limit=rating.torque / (1.5 * POLE_PAIRS * flux),
        )

    @classmethod
    def drawn(cls, rng: Rng) -> Numbers:  # noqa: D102
        return {
            "resistance": scaled(rng, 0.3, 1.0),
            "inductance_d": scaled(rng, 1e-3, 3e-3),
            "inductance_q": scaled(rng, 1e-3, 3e-3),
            "flux": scaled(rng, 0.005, 0.02),
            "pole_pairs": POLE_PAIRS,
        }

    @property
    def circuit(self) -> Circuit:
        """Return the winding across the flux."""
        return Circuit(self.resistance, self.inductance_q, self.pole_pairs * self.flux)

    def data_sheet(self, supply_voltage: float) -> tuple[float, ...]:  # noqa: D102
        inductances = self.inductance_d, self.inductance_q
        amplitude = supply_voltage / AMPLITUDE
        return (self.resistance, *inductances, self.flux, self.pole_pairs, amplitude)

    @property
    def servo_data(self) -> ServoData:
        """Across the flux it is a dc motor, without products of currents and speed."""
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
        return supply_voltage / AMPLITUDE

    def felt_at_link(self, ratio: float) -> dict[str, float]:  # noqa: D102
        return {
            "rotor inertia": self.rotor_inertia / ratio**2,
            "torque per current": 1.5 * self.pole_pairs * self.flux / abs(ratio),
            "voltage per speed": self.pole_pairs * self.flux / abs(ratio),
        }
