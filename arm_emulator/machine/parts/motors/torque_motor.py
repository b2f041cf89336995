"""Motors with ideal torque control."""

from typing import Self

from arm_emulator.machine.parts.input import TORQUE
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
class TorqueMotor(Motor):
    """The torque follows the command, with a bandwidth if there is one."""

    kind = "torque"
    regulated = True
    hides = ("current_sensor.gain_error", "current_sensor.range")  # whose readings are 0
    header = "motors/torque_motor.hpp"
    cxx = "TorqueMotor"
    inputs = (TORQUE,)
    limit = "torque_limit"
    rules = ("limit at the peak torque, bandwidth of drives that sample at 16 kHz",)

    rotor_inertia: float = declare_rotor_inertia()
    bandwidth: float | None = number(
        "bandwidth", "Hz", above=0.0, default=None, text="f; without it the torque has no delay"
    )
    torque_limit: float | None = number(
        "torque_limit",
        "N m",
        above=0.0,
        default=None,
        text="largest command at the motor shaft, in either direction",
    )

    @classmethod
    def size_part(cls, rating: Rating) -> Self:  # noqa: D102
        return cls(
            rotor_inertia=rating.rotor_inertia,
            bandwidth=rating.bandwidth,
            torque_limit=rating.torque,
        )

    @property
    def servo_data(self) -> ServoData:  # noqa: D102
        return ServoData(torque_constant=1.0, torque_bandwidth=self.bandwidth or AT_ONCE)

    @property
    def torque_per_command(self) -> float:  # noqa: D102
        return 1.0

    def compute_largest_command(self, supply_voltage: float) -> float | None:  # noqa: D102
        return self.torque_limit

    def reflect_to_link(self, ratio: float) -> dict[str, float]:  # noqa: D102
        return {"rotor inertia": self.rotor_inertia / ratio**2}
