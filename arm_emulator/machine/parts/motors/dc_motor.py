"""Direct-current motors."""

from typing import Self

from arm_emulator.machine.parts.motors.motor import (
    Circuit,
    Motor,
    Rating,
    ServoData,
    declare_rotor_inertia,
)
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part


@register_part
class DcMotor(Motor):
    """Armature circuit and rotor, eq. (1) and (2). `inductance` 0: the current has no delay."""

    kind = "dc"
    cia_type = 13  # permanent magnets, commutator
    is_default = True
    has_winding = True
    header = "motors/dc_motor.hpp"
    cxx = "DcMotor"
    limit = "current_limit"  # with a current loop
    rules = (
        "back EMF 60 % of the supply at full speed, 25 % for the winding at peak torque,",
        "L/R 1 ms; current of the peak torque; current loop of drives that sample at 16 kHz",
    )

    resistance: float = number("R", "ohm", above=0.0, text="R of the winding")
    inductance: float = number(
        "L", "H", at_least=0.0, default=0.0, text="L of the winding; 0: the current has no delay"
    )
    torque_constant: float = number("Kt", "N m/A", above=0.0, text="Kt")
    back_emf_constant: float = number(
        "Kb",
        "V s/rad",
        at_least=0.0,
        text="Kb; equals Kt in SI units if the motor has no other losses",
    )
    rotor_inertia: float = declare_rotor_inertia()
    current_limit: float | None = number(
        "current_limit",
        "A",
        above=0.0,
        default=None,
        text="the largest current, in either direction; with a current loop that of its commands",
    )

    @classmethod
    def size_part(cls, rating: Rating) -> Self:  # noqa: D102
        return cls(
            resistance=rating.resistance,
            inductance=rating.inductance,
            torque_constant=rating.torque_constant,
            back_emf_constant=rating.back_emf_constant,
            rotor_inertia=rating.rotor_inertia,
            current_limit=rating.current,
        )

    @property
    def cxx_type(self) -> str:  # noqa: D102
        return "arm::DcMotor" if self.current_limit is None else "arm::LimitedDcMotor"

    @property
    def has_algebraic_current(self) -> bool:  # noqa: D102
        return self.inductance == 0.0

    @property
    def circuit(self) -> Circuit | None:  # noqa: D102
        if self.inductance == 0.0:
            return None
        return Circuit(self.resistance, self.inductance, self.back_emf_constant)

    def read_data_sheet(self, supply_voltage: float) -> tuple[float, ...]:  # noqa: D102
        return self.resistance, self.inductance, self.back_emf_constant, supply_voltage

    @property
    def servo_data(self) -> ServoData:  # noqa: D102
        return ServoData(
            torque_constant=self.torque_constant,
            resistance=self.resistance,
            inductance=self.inductance,
            back_emf_constant=self.back_emf_constant,
        )

    @property
    def torque_per_command(self) -> float:  # noqa: D102
        return self.torque_constant / self.resistance

    def compute_largest_command(self, supply_voltage: float) -> float | None:  # noqa: D102
        return supply_voltage

    def reflect_to_link(self, ratio: float) -> dict[str, float]:  # noqa: D102
        return {
            "rotor inertia": self.rotor_inertia / ratio**2,
            "torque per current": self.torque_constant / abs(ratio),
            "voltage per speed": self.back_emf_constant / abs(ratio),
        }
