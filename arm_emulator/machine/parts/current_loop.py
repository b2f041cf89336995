"""The current loop of a motor's drive."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from arm_emulator.base.section import Section
from arm_emulator.machine import cxx_literals
from arm_emulator.machine.chain import Array
from arm_emulator.machine.parts.motor import Circuit
from arm_emulator.machine.parts.part import Number, Part
from arm_emulator.machine.parts.resting import AtRest, Share
from arm_emulator.machine.parts.shaft_motion import ShaftMotion


@dataclass(frozen=True, kw_only=True)
class CurrentLoop(Part):
    """A PI controller within the drive: the motor's command is a current.

    Its gains follow from the bandwidth and the data sheet, or are given.
    """

    section = "motor.current_loop"
    shaft = "rotor"
    header = "current_loop.hpp"
    cxx = "CurrentControl"

    bandwidth: Annotated[float | None, Number("bandwidth", "Hz", above=0.0)] = None
    proportional_gain: Annotated[float | None, Number("P", "V/A", above=0.0)] = None
    integral_gain: Annotated[float | None, Number("I", "V/(A s)", at_least=0.0)] = None
    emf_feedforward: Annotated[float, Number("feedforward", "1", at_least=0.0, at_most=1.0)] = 1.0

    def effort(self, motion: ShaftMotion) -> Array:
        """None: what is measured is the torque behind it."""
        return np.zeros_like(motion.t)

    def rests(self, at: AtRest) -> Share | str:
        """It is within the servo's loop, whose integral takes up what it leaves."""
        return Share()

    def check(self, section: Section) -> None:  # noqa: D102
        gains = {"proportional_gain": self.proportional_gain, "integral_gain": self.integral_gain}
        for key, value in gains.items():
            if self.bandwidth is not None and value is not None:
                raise section.refusal(key, "be absent beside a bandwidth", value)
            if self.bandwidth is None and value is None:
                rule = f"be given where {key} is not"
                raise section.refusal("bandwidth", rule, "nothing")

    def bandwidth_around(self, circuit: Circuit) -> float:
        """Return how fast the current follows the command [Hz]."""
        if self.bandwidth is not None:
            return self.bandwidth
        assert self.proportional_gain is not None, "see check"
        return self.proportional_gain / (2.0 * math.pi * circuit.inductance)

    def around_type(self, motor: str) -> str:
        """Return the C++ type of a motor with it."""
        return f"arm::CurrentLoop<{motor}>"

    def around(
        self, motor_type: str, motor: str, control: str, circuit: Circuit, supply_voltage: float
    ) -> str:
        """Return a motor with it in C++.

        Args:
            motor_type: the motor's type there.
            motor: the motor there.
            control: its own numbers there.
            circuit: the winding for which the drive was set up.
            supply_voltage: of the drive [V].
        """
        numbers = (
            circuit.resistance,
            circuit.inductance,
            circuit.back_emf_constant,
            supply_voltage,
        )
        known = ", ".join(map(cxx_literals.number, numbers))
        return f"{self.around_type(motor_type)}{{{motor}, {control}, {{{known}}}}}"
