"""Hybrid stepper motors."""

from arm_emulator.machine.parts.input import Input
from arm_emulator.machine.parts.motors.motor import Motor, declare_rotor_inertia
from arm_emulator.machine.parts.output import FURTHER, Output
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part


@register_part
class Stepper(Motor):
    """Two phases whose currents follow their commands; the rotor's teeth follow the currents."""

    kind = "stepper"
    regulated = True
    cia_type = 9  # with microsteps
    limit = "current_limit"
    header = "motors/stepper.hpp"
    cxx = "StepperMotor"
    inputs = (
        Input("command", "current of each stepper's first phase", "A", mode="ARM_CURRENT"),
        Input("command_b", "current of its second phase", "A", applied="applied_b"),
    )
    outputs = (
        Output("applied_b", "command_b that acted on each motor in the past servo period", FURTHER),
    )

    torque_per_current: float = number("Kt", "N m/A", above=0.0, text="Kt, the most of a phase")
    resistance: float = number(
        "R",
        "ohm",
        at_least=0.0,
        default=0.0,
        text="R of a phase, for the power that it takes: it changes no motion",
    )
    teeth: int = number("p", "teeth", ends=(1.0, 1000.0), whole=True, text="p; 50 of 1.8° a step")
    rotor_inertia: float = declare_rotor_inertia()
    bandwidth: float = number("bandwidth", "Hz", above=0.0, text="f, of its drivers")
    current_limit: float | None = number(
        "current_limit", "A", above=0.0, default=None, text="of each phase, in either direction"
    )

    @property
    def servo_data(self) -> None:
        """None: our servo does not commutate."""
        return

    @property
    def torque_per_command(self) -> float:
        """The most of the first phase."""
        return self.torque_per_current

    def compute_largest_command(self, supply_voltage: float) -> float | None:  # noqa: D102
        return self.current_limit

    def reflect_to_link(self, ratio: float) -> dict[str, float]:  # noqa: D102
        return {
            "rotor inertia": self.rotor_inertia / ratio**2,
            "torque per current": self.torque_per_current / abs(ratio),
        }
