"""Friction that grows with the torque of the gear."""

from __future__ import annotations

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.machine.parts.frictions.friction import Friction, LinkFriction, OfRotor
from arm_emulator.machine.parts.frictions.stribeck import compute_stribeck_torque
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion


class LoadFriction(Friction):
    """Further friction: `load` times the gear's torque on that shaft."""

    header = "frictions/load_friction.hpp"
    cxx = "LoadFriction"
    named_by = ("load",)

    stribeck: float | None = number(
        "vs",
        "rad/s",
        above=0.0,
        sought="known",
        default=None,
        absent="Coulomb friction",
        text="vs, see [Stribeck friction](stribeck.md)",
    )
    load: float = number("mu", "N m/(N m)", ends=(0.0, 10.0), sought="known", text="mu")

    def sliding(self, motion: ShaftMotion) -> Array:  # noqa: D102
        dry = super().sliding(motion)
        if self.stribeck is not None:
            dry = compute_stribeck_torque(self.coulomb, self.breakaway, self.stribeck, motion.speed)
        torque: Array = dry + self.load * np.abs(motion.gear_torque)
        return torque

    @property
    def sticks(self) -> bool:  # noqa: D102
        return self.coulomb > 0.0 or self.load > 0.0


@register_part
class LinkLoadFriction(LoadFriction, LinkFriction):
    """Friction of a link that grows with the load on its gear."""


@register_part
class RotorLoadFriction(OfRotor, LoadFriction):
    """Friction of a rotor that grows with the load on its gear."""
