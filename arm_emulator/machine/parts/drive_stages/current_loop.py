"""The current loop of a motor's drive."""

import math
from typing import ClassVar, Self

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.section import Section
from arm_emulator.machine import cxx_literals
from arm_emulator.machine.parts.drive_stages.drive_stage import DriveStage, Supply
from arm_emulator.machine.parts.input import CURRENT, Input
from arm_emulator.machine.parts.motors.motor import Circuit, CxxMotor, Motor, Rating
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion


@register_part
class CurrentLoop(DriveStage):
    """A PI controller within the drive: the motor's command is a current.

    Its gains follow from the bandwidth and the data sheet, or are given.
    """

    section = "motor.current_loop"
    layer = 1
    needs_circuit = True
    inputs: ClassVar[tuple[Input, ...]] = (CURRENT,)
    header = "drive_stages/current_loop.hpp"
    cxx = "CurrentControl"
    loop: ClassVar[str] = "CurrentLoop"  # in C++, around a motor

    bandwidth: float | None = number(
        "bandwidth",
        "Hz",
        above=0.0,
        default=None,
        absent="by the gains",
        text="f; P and I follow from it",
    )
    proportional_gain: float | None = number(
        "P", "V/A", above=0.0, default=None, absent="by the bandwidth", text="P"
    )
    integral_gain: float | None = number(
        "I", "V/(A s)", at_least=0.0, default=None, absent="by the bandwidth", text="I"
    )
    emf_feedforward: float = number(
        "feedforward",
        "1",
        ends=(0.0, 1.0),
        default=1.0,
        text="E, share of the induced voltages that the drive compensates",
    )

    def compute_effort(self, motion: ShaftMotion) -> Array:
        """None: measured torques are those behind it."""
        return np.zeros_like(motion.t)

    def check_numbers(self, section: Section) -> None:  # noqa: D102
        gains = {"proportional_gain": self.proportional_gain, "integral_gain": self.integral_gain}
        for key, value in gains.items():
            if self.bandwidth is not None and value is not None:
                raise section.make_refusal(key, "be absent together with a bandwidth", value)
            if self.bandwidth is None and value is None:
                rule = f"be given where {key} is not"
                raise section.make_refusal("bandwidth", rule, "nothing")

    @classmethod
    def size_part(cls, motor: Motor, rating: Rating) -> Self | None:  # noqa: D102
        return None if motor.circuit is None else cls(bandwidth=rating.bandwidth)

    def convert_unit_command(self, motor: Motor) -> float:  # noqa: D102
        return _get_circuit(motor).resistance

    def compute_bandwidth(self, motor: Motor) -> float:  # noqa: D102
        if self.bandwidth is not None:
            return self.bandwidth
        assert self.proportional_gain is not None, "see check"
        return self.proportional_gain / (2.0 * math.pi * _get_circuit(motor).inductance)

    def wrap_motor(self, motor: Motor, inner: CxxMotor, own: str, supply: Supply) -> CxxMotor:
        """Return a motor with it in C++, set up for the motor's winding."""
        *sheet, max_voltage = map(cxx_literals.format_number, motor.read_data_sheet(supply.voltage))
        max_voltage = f"{max_voltage} * {supply.share}" if supply.share else max_voltage
        kind = f"arm::{self.loop}<{inner.type}>"
        return CxxMotor(
            kind, f"{kind}{{{inner.value}, {own}, {{{', '.join([*sheet, max_voltage])}}}}}"
        )


def _get_circuit(motor: Motor) -> Circuit:
    assert motor.circuit is not None, "see check_motor"
    return motor.circuit
