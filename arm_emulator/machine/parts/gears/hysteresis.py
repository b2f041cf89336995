"""Hysteresis of elastic gears."""

from typing import Any

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.number import Number
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.gears.gear import Gear
from arm_emulator.machine.parts.gears.gear_stage import GearStage
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion

TWISTED = "slow reversals of loads that twist the gear beyond its loop, and an encoder at the link"
# The count is a part of the C++ type, no number of it.
_ELEMENTS = Number(
    "elements", "elements", at_least=1, at_most=16, whole=True, default=4, text="n, their count"
)


def follow_at_distance(path: Array, distance: float) -> Array:
    """Return what begins at 0 and follows a path (K,) that is farther than a distance away.

    From one reversal of the path to the next it only goes the path's way.
    """
    followed, at = np.empty_like(path), 0.0
    reversals = np.flatnonzero(np.diff(np.sign(np.diff(path)))) + 2  # behind the reversal itself
    for begin, end in zip([0, *reversals], [*reversals, len(path)], strict=True):
        rows = path[begin:end]
        followed[begin:end] = np.minimum(np.maximum(at, rows - distance), rows + distance)
        at = followed[end - 1] if end > begin else at
    return followed


@register_part
class Hysteresis(GearStage):
    """Springs beside that of an elastic gear, which bend with its twist and slip in turn."""

    section = "gear.hysteresis"
    header = "gears/hysteresis.hpp"
    cxx = "Hysteresis"
    keys = (_ELEMENTS,)
    loop_keys = ("torque", "twist")

    torque: float = number(
        "F", "N m", above=0.0, excitation=TWISTED, text="F at the link, when all elements slip"
    )
    twist: float = number(
        "twist", "rad", above=0.0, excitation=TWISTED, text="at the link, beyond which all slip"
    )
    elements: int = 4

    @classmethod
    def read_numbers(cls, section: Section) -> dict[str, Any]:  # noqa: D102
        return super().read_numbers(section) | {"elements": section.read_integer(_ELEMENTS)}

    def compute_effort(self, motion: ShaftMotion) -> Array:
        """None: rotor and link pass the torque on."""
        return np.zeros_like(motion.t)

    def compute_loop_torque(self, twist: Array) -> Array:  # noqa: D102
        n, bent = self.elements, np.zeros_like(twist)
        for i in range(n):
            limit = self.twist * (2 * i + 1) / (2 * n)
            bent += twist - follow_at_distance(twist, limit)
        torque: Array = 2.0 * self.torque / (n * self.twist) * bent
        return torque

    def check_gear(self, gear: Gear, joint: Section) -> None:  # noqa: D102
        if gear.stiffness is None or gear.has_play:
            rule = "belong to an elastic gear without play"
            raise joint.make_refusal(self.section, rule, type(gear).__name__)

    @property
    def cxx_type(self) -> str:  # noqa: D102
        return f"arm::{self.cxx}<{self.elements}>"

    def wrap_gear(self, kind: str, gear: str, own: str) -> tuple[str, str]:  # noqa: D102
        wrapped = f"arm::HystereticGear<{kind}, {self.elements}>"
        return wrapped, f"{wrapped}{{{gear}, {own}}}"
