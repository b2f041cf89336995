"""The temperature of a motor's winding."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from arm_emulator.base.section import Section
from arm_emulator.machine.chain import Array
from arm_emulator.machine.parts.output import FAULTS, Output
from arm_emulator.machine.parts.part import Number, Part
from arm_emulator.machine.parts.resting import AtRest, Share
from arm_emulator.machine.parts.shaft_motion import ShaftMotion


@dataclass(frozen=True, kw_only=True)
class Winding(Part):
    """The copper loss heats the winding, and resistance and constants follow its temperature.

    Their ranges keep the resistance positive at any temperature from the ambient up.
    """

    section = "motor.winding"
    shaft = "rotor"
    header = "winding.hpp"
    cxx = "Winding"
    outputs = (FAULTS,)

    heat_capacity: Annotated[float, Number("C", "J/K", above=0.0)]
    thermal_resistance: Annotated[float, Number("Rth", "K/W", above=0.0)]
    ambient: Annotated[float, Number("ambient", "degC", at_least=-50.0, at_most=150.0)] = 20.0
    reference: Annotated[float, Number("reference", "degC", at_least=-50.0, at_most=150.0)] = 20.0
    # Of copper.
    resistance_coefficient: Annotated[
        float, Number("alpha", "1/K", at_least=0.0, at_most=0.0045)
    ] = 0.0039
    magnet_coefficient: Annotated[float, Number("beta", "1/K", at_least=-0.01, at_most=0.0)] = 0.0
    limit: Annotated[float | None, Number("limit", "degC", above=0.0, at_most=1000.0)] = None

    def effort(self, motion: ShaftMotion) -> Array | None:
        """None, unless magnets keep their strength; then heat changes the resistance alone."""
        return None if self.magnet_coefficient else np.zeros_like(motion.t)

    def rests(self, at: AtRest) -> Share | str:
        """A warm motor gives less torque for its current: the servo's integral asks for more."""
        return Share()

    def check(self, section: Section) -> None:  # noqa: D102
        if self.limit is not None and self.limit <= self.ambient:
            rule = f"be above the ambient, {self.ambient:g} degC"
            raise section.refusal("limit", rule, self.limit)

    @property
    def reports(self) -> tuple[Output, ...]:
        """A fault where its temperature is limited."""
        return () if self.limit is None else self.outputs

    def around_type(self, motor: str) -> str:
        """Return the C++ type of a motor with it."""
        return f"arm::HeatedMotor<{motor}>"

    def around(self, motor_type: str, motor: str, winding: str) -> str:
        """Return a motor with it in C++, `winding` its own numbers there."""
        return f"{self.around_type(motor_type)}{{{motor}, {winding}}}"
