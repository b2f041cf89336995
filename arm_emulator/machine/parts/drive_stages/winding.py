"""The temperature of a motor's winding."""

from typing import Any

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.drive_stages.drive_stage import DriveStage, Supply
from arm_emulator.machine.parts.fault import GROWS, Fault, bound_rise, declare_rise
from arm_emulator.machine.parts.motors.motor import CxxMotor, Motor
from arm_emulator.machine.parts.output import FAULTS, Output
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion


def declare_temperature(symbol: str, text: str) -> Any:
    """Return a dataclass field that is a temperature of surroundings or of a data sheet [degC]."""
    return number(symbol, "degC", ends=(-50.0, 150.0), default=20.0, text=text)


@register_part
class Winding(DriveStage):
    """The copper loss heats the winding, and resistance and constants follow its temperature.

    Their ranges keep the resistance positive at any temperature from the ambient up.
    """

    section = "motor.winding"
    layer = 2
    header = "drive_stages/winding.hpp"
    cxx = "Winding"
    outputs = (FAULTS,)
    truths = (
        Output("winding_temperature", "true temperature of the winding", "winding_temperature",
               "degC"),
    )  # fmt: skip

    heat_capacity: float = number("C", "J/K", above=0.0, text="C, of the winding")
    thermal_resistance: float = number(
        "Rth", "K/W", above=0.0, text="Rth, from the winding to the ambient"
    )
    ambient: float = declare_temperature(
        "ambient", "temperature around the motor, at which it starts"
    )
    reference: float = declare_temperature(
        "reference", "temperature at which the motor's numbers hold"
    )
    # Of copper.
    resistance_coefficient: float = number(
        "alpha", "1/K", ends=(0.0, 0.0045), default=0.0039, text="alpha, of copper"
    )
    magnet_coefficient: float = number(
        "beta",
        "1/K",
        ends=(-0.01, 0.0),
        default=0.0,
        text="beta; some -0.001 of NdFeB, -0.002 of ferrite",
    )
    limit: float | None = number(
        "limit",
        "degC",
        above=0.0,
        at_most=1000.0,
        default=None,
        text="the drive is off above it; must exceed `ambient`",
    )

    def compute_effort(self, motion: ShaftMotion) -> Array | None:
        """Known only if the magnets are constant: then heat changes the resistance alone."""
        return None if self.magnet_coefficient else np.zeros_like(motion.t)

    @classmethod
    def list_faults(cls) -> tuple[Fault, ...]:  # noqa: D102
        return (
            Fault(
                "cooling_fails",
                "the winding's thermal resistance grows",
                sets={"motor.winding.thermal_resistance": GROWS},
                magnitude=bound_rise("1", 9.0, 1e6),
            ),
            Fault(
                "ambient_rises",
                "the air around the motor is warmer",
                sets=declare_rise("motor.winding.ambient"),
                magnitude=bound_rise("K", 40.0, 300.0),
            ),
        )

    def check_numbers(self, section: Section) -> None:  # noqa: D102
        if self.limit is not None and self.limit <= self.ambient:
            rule = f"be above the ambient, {self.ambient:g} degC"
            raise section.make_refusal("limit", rule, self.limit)

    @property
    def reports(self) -> tuple[Output, ...]:
        """A fault where its temperature is limited."""
        return () if self.limit is None else self.outputs

    def check_motor(self, motor: Motor, joint: Section) -> None:  # noqa: D102
        if not motor.has_winding:
            rule = "belong to a motor that has a resistance"
            raise joint.make_refusal(self.section, rule, motor.kind, "dc, pmsm")
        if motor.has_algebraic_current:
            rule = "come with an inductance: the current would follow the temperature at once"
            raise joint.make_refusal(self.section, rule, "none")

    def wrap_motor(self, motor: Motor, inner: CxxMotor, own: str, supply: Supply) -> CxxMotor:  # noqa: D102
        kind = f"arm::HeatedMotor<{inner.type}>"
        return CxxMotor(kind, f"{kind}{{{inner.value}, {own}}}")
