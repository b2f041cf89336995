"""Permanent-magnet synchronous motors."""

import math
from collections.abc import Mapping
from typing import Self

from arm_emulator.base.validation.section import Section
from arm_emulator.machine import cxx_literals
from arm_emulator.machine.parts.fault import RISES, Fault, bound_share
from arm_emulator.machine.parts.input import Input
from arm_emulator.machine.parts.motors.motor import (
    Circuit,
    CxxMotor,
    Motor,
    Rating,
    ServoData,
    declare_rotor_inertia,
)
from arm_emulator.machine.parts.output import FURTHER, Output
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part

AMPLITUDE = math.sqrt(3.0)  # of the supply to the largest that an inverter makes of it
POLE_PAIRS = 4  # of servo motors, where none are given


@register_part
class Pmsm(Motor):
    """A permanent-magnet synchronous motor in the frame of its rotor, amplitudes of its phases."""

    kind = "pmsm"
    cia_type = 10  # sinusoidal, permanent magnets
    has_winding = True
    limit = "current_limit"
    rules = (
        "three phases at supply / sqrt(3): back EMF 60 % of it at full speed, 25 % for the winding",
        "at peak torque, L/R 1 ms; current of the peak torque; drives that sample at 16 kHz",
    )
    header = "motors/pmsm.hpp"
    cxx = "Pmsm"
    inputs = (
        Input("command", "voltage across each rotor's flux", "V", mode="ARM_VOLTAGE_DQ"),
        Input("command_d", "voltage along each rotor's flux", "V", applied="applied_d"),
    )
    outputs = (
        Output("current_d", "current along each rotor's flux", "current_d", "A"),
        Output("applied_d", "command_d that acted on each motor in the past servo period", FURTHER),
    )

    resistance: float = number("R", "ohm", above=0.0, text="R of a phase")
    inductance_d: float = number("Ld", "H", above=0.0, text="Ld, along the flux")
    inductance_q: float = number("Lq", "H", above=0.0, text="Lq, across it")
    flux: float = number(
        "psi",
        "V s",
        at_least=0.0,
        text="psi, amplitude of the magnets' flux linkage; 0: a reluctance motor",
    )
    pole_pairs: int = number("p", "pairs", ends=(1.0, 1000.0), whole=True, text="p")
    rotor_inertia: float = declare_rotor_inertia()
    current_limit: float | None = number(
        "current_limit",
        "A",
        above=0.0,
        default=None,
        absent="unlimited",
        text="of the commands of its [current loops](field_oriented_loop.md); refused without them",
    )

    def check_numbers(self, section: Section) -> None:  # noqa: D102
        if self.current_limit is not None and not section.has_key("current_loop"):
            rule = "come with a current_loop, whose commands it bounds"
            raise section.make_refusal("current_limit", rule, self.current_limit)

    @classmethod
    def size_part(cls, rating: Rating) -> Self:
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
    def list_faults(cls) -> tuple[Fault, ...]:  # noqa: D102
        return (
            Fault(
                "phase_lost",
                "one of three phases carries no current, with the star point connected",
                sets={"motor.flux": "{x} * (1.0 - {m} / 3.0)", "motor.phase_lost": RISES},
                magnitude=bound_share(),
                needs="motor.phase_lost",
            ),
        )

    def list_fault_numbers(self) -> dict[str, float | None]:
        """Its numbers, and how far one of its phases is lost."""
        return {**super().list_fault_numbers(), "phase_lost": 0.0}

    def list_headers(self, joint: str, places: Mapping[str, str]) -> tuple[str, ...]:  # noqa: D102
        ripple = ["drive_stages/torque_ripple.hpp"] if self._find_lost_share(joint, places) else []
        return (*super().list_headers(joint, places), *ripple)

    def wrap_motor(self, inner: CxxMotor, joint: str, places: Mapping[str, str]) -> CxxMotor:
        """Return it with the ripple of a lost phase.

        The other two phases keep their currents, since their star point is connected. The torque
        over three phases is ``k iq 2/3 sum sin^2(p tm - 2 pi j / 3)``. The remaining torque is
        ``k iq (1 - 2/3 sin^2 p tm) = k iq 2/3 (1 + cos(2 p tm) / 2)``. The induced voltage keeps
        the same share: a smaller flux with a ripple.
        """
        lost = self._find_lost_share(joint, places)
        if not lost:
            return inner
        kind = f"arm::RippledMotor<{inner.type}, 1>"
        order, quarter = (
            cxx_literals.format_number(x) for x in (2.0 * self.pole_pairs, 0.5 * math.pi)
        )
        wave = f"{{{order}, {lost} / (3.0 - {lost}), {quarter}}}"
        return CxxMotor(kind, f"{kind}{{{inner.value}, {{{{{wave}}}}}}}")

    def _find_lost_share(self, joint: str, places: Mapping[str, str]) -> str | None:
        """Return the share of a phase that is lost, in C++; None: no fault of it is listed."""
        return places.get(f"joints.{joint}.{self.section}.phase_lost")

    @property
    def circuit(self) -> Circuit:
        """Return the winding across the flux."""
        return Circuit(self.resistance, self.inductance_q, self.pole_pairs * self.flux)

    def read_data_sheet(self, supply_voltage: float) -> tuple[float, ...]:  # noqa: D102
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

    def compute_largest_command(self, supply_voltage: float) -> float | None:  # noqa: D102
        return supply_voltage / AMPLITUDE

    def reflect_to_link(self, ratio: float) -> dict[str, float]:  # noqa: D102
        return {
            "rotor inertia": self.rotor_inertia / ratio**2,
            "torque per current": 1.5 * self.pole_pairs * self.flux / abs(ratio),
            "voltage per speed": self.pole_pairs * self.flux / abs(ratio),
        }
