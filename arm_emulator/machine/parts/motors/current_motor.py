"""Motors with ideal current control."""

from typing import Self

from arm_emulator.machine.parts.input import CURRENT
from arm_emulator.machine.parts.motors.motor import (
    AT_ONCE,
    Motor,
    Rating,
    ServoData,
    declare_rotor_inertia,
)
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part


@register_part
class CurrentMotor(Motor):
    """The current follows the command, with a bandwidth if there is one."""

    kind = "current"
    regulated = True
    header = "motors/current_motor.hpp"
    cxx = "CurrentMotor"
    inputs = (CURRENT,)
    limit = "current_limit"
    rules = ("current of the peak torque, bandwidth of drives that sample at 16 kHz",)

    torque_constant: float = number("Kt", "N m/A", above=0.0, text="Kt")
    resistance: float = number(
        "R",
        "ohm",
        at_least=0.0,
        default=0.0,
        text="R, for the power that the winding takes: it changes no motion",
    )
    rotor_inertia: float = declare_rotor_inertia()
    bandwidth: float | None = number(
        "bandwidth", "Hz", above=0.0, default=None, text="f; without it the current has no delay"
    )
    current_limit: float | None = number(
        "current_limit", "A", above=0.0, default=None, text="largest command, in either direction"
    )

    @classmethod
    def size_part(cls, rating: Rating) -> Self:  # noqa: D102
        return cls(
            torque_constant=rating.torque_constant,
            resistance=rating.resistance,
            rotor_inertia=rating.rotor_inertia,
            bandwidth=rating.bandwidth,
            current_limit=rating.current,
        )

    @property
    def servo_data(self) -> ServoData:  # noqa: D102
        bandwidth = self.bandwidth or AT_ONCE
        return ServoData(torque_constant=self.torque_constant, current_bandwidth=bandwidth)

    @property
    def torque_per_command(self) -> float:  # noqa: D102
        return self.torque_constant

    def compute_largest_command(self, supply_voltage: float) -> float | None:  # noqa: D102
        return self.current_limit

    def reflect_to_link(self, ratio: float) -> dict[str, float]:  # noqa: D102
        return {
            "rotor inertia": self.rotor_inertia / ratio**2,
            "torque per current": self.torque_constant / abs(ratio),
        }
