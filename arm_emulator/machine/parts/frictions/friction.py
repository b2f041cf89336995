"""Friction of links and of rotors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.part import Part, number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.sample import Numbers, Rng, scaled
from arm_emulator.machine.parts.shaft_motion import ShaftMotion


class Friction(Part):
    """Viscous, and Coulomb's: `coulomb` while the shaft slides, `breakaway` at rest."""

    header = "frictions/friction.hpp"
    cxx = "Friction"
    named_by: ClassVar[tuple[str, ...]] = ()  # keys of friction of this kind, beside these three

    usual_dry: ClassVar[float] = 0.6  # N m, while it slides
    usual_viscous: ClassVar[float] = 0.1  # N m s/rad
    usual_speed: ClassVar[float] = 0.2  # rad/s, of slow motion

    viscous: float = number(
        "Dv", "N m s/rad", at_least=0.0, sought="unknown", default=0.0, text="Dv, per speed"
    )
    coulomb: float = number(
        "Dc", "N m", at_least=0.0, sought="unknown", default=0.0, text="Dc, while the shaft turns"
    )
    breakaway: float = number(
        "Ds",
        "N m",
        follows="coulomb",
        default=0.0,
        text="Ds, what a shaft at rest withstands; refused without `coulomb`",
    )

    @classmethod
    def owned_name(cls) -> str:
        """Return its section and the keys that distinguish it."""
        return " with ".join([super().owned_name(), *sorted(cls.named_by)])

    @classmethod
    def drawn(cls, rng: Rng) -> Numbers:  # noqa: D102
        dry = cls.usual_dry * scaled(rng, 0.3, 3.0)
        return {"coulomb": dry, "breakaway": 1.3 * dry, "viscous": cls.usual_viscous}

    def sliding(self, motion: ShaftMotion) -> Array:
        """Return the dry torque (K,) against a shaft that turns [N m]."""
        return np.full_like(motion.speed, self.coulomb)

    def effort(self, motion: ShaftMotion) -> Array:  # noqa: D102
        return self.viscous * motion.speed + self.sliding(motion) * np.sign(motion.speed)

    @property
    def sticks(self) -> bool:  # noqa: D102
        return self.coulomb > 0.0

    def check(self, section: Section) -> None:  # noqa: D102
        if self.breakaway > 0.0 and self.coulomb == 0.0:
            raise section.refusal("breakaway", "come with a coulomb friction", self.breakaway)


@register_part
class LinkFriction(Friction):
    """Friction at the link."""

    section = "friction"


class OfRotor(Friction):
    """Any law of friction at the motor's shaft."""

    section = "motor.friction"
    shaft = "rotor"
    usual_dry = 0.01
    usual_viscous = 1e-5
    usual_speed = 6.0

    @property
    def cxx_type(self) -> str:  # noqa: D102
        return f"arm::RotorFriction<{super().cxx_type}>"

    def initialiser(self, joint: str, places: Mapping[str, str]) -> str:  # noqa: D102
        return f"{self.cxx_type}{{{self.law(joint, places)[1]}}}"

    def law(self, joint: str, places: Mapping[str, str]) -> tuple[str, str]:
        """Return type and initialiser of the law alone."""
        kind = super().cxx_type
        members = ", ".join(f".{name} = {value}" for name, value in self.members(joint, places))
        return kind, f"{kind}{{{members}}}"


@register_part
class RotorFriction(OfRotor):
    """Friction at the motor's shaft."""
