"""Friction that falls as a shaft begins to slide."""

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.machine.parts.frictions.friction import Friction, LinkFriction, OfRotor
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion


def compute_stribeck_torque(
    coulomb: float, breakaway: float, stribeck: float, speed: Array
) -> Array:
    """Return the torque against sliding that falls from `breakaway` to `coulomb` [N m]."""
    fallen = np.exp(-np.minimum((speed / stribeck) ** 2, 700.0))
    torque: Array = coulomb + (breakaway - coulomb) * fallen
    return torque


class Stribeck(Friction):
    """From `breakaway` at rest to `coulomb`, by exp(-(speed / stribeck)^2)."""

    header = "frictions/stribeck.hpp"
    cxx = "Stribeck"
    named_by = ("stribeck",)

    stribeck: float = number(
        "vs",
        "rad/s",
        above=0.0,
        prior="known",
        text="vs: speed at which 63 % of the fall from Ds to Dc has happened",
    )

    def compute_dry_torque(self, motion: ShaftMotion) -> Array:  # noqa: D102
        return compute_stribeck_torque(self.coulomb, self.breakaway, self.stribeck, motion.speed)


@register_part
class LinkStribeck(Stribeck, LinkFriction):
    """Friction of a link that falls as it begins to slide."""


@register_part
class RotorStribeck(OfRotor, Stribeck):
    """Friction of a rotor that falls as it begins to turn."""
