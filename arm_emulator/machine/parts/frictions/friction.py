"""Friction of links and of rotors."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.gears.gear import Gear
from arm_emulator.machine.parts.part import Part, number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion


class Friction(Part):
    """Viscous, and Coulomb's: `coulomb` while the shaft slides, `breakaway` at rest."""

    header = "frictions/friction.hpp"
    cxx = "Friction"
    named_by: ClassVar[tuple[str, ...]] = ()  # keys of friction of this kind, beside these three

    viscous: float = number(
        "Dv", "N m s/rad", at_least=0.0, prior="unknown", default=0.0, text="Dv, per speed"
    )
    coulomb: float = number(
        "Dc", "N m", at_least=0.0, prior="unknown", default=0.0, text="Dc, while the shaft turns"
    )
    breakaway: float = number(
        "Ds",
        "N m",
        follows="coulomb",
        default=0.0,
        text="Ds, what a shaft at rest withstands; refused without `coulomb`",
    )

    @classmethod
    def name_place(cls) -> str:
        """Return its section and the keys that distinguish it."""
        return " with ".join([super().name_place(), *sorted(cls.named_by)])

    @classmethod
    def is_named_in(cls, section: Section) -> bool:
        """Whether the keys of a section name this law."""
        return all(map(section.has_key, cls.named_by))

    def compute_dry_torque(self, motion: ShaftMotion) -> Array:
        """Return the dry torque (K,) against a shaft that turns [N m]."""
        return np.full_like(motion.speed, self.coulomb)

    def compute_effort(self, motion: ShaftMotion) -> Array:  # noqa: D102
        return self.viscous * motion.speed + self.compute_dry_torque(motion) * np.sign(motion.speed)

    @property
    def can_stick(self) -> bool:  # noqa: D102
        return self.coulomb > 0.0

    def check_numbers(self, section: Section) -> None:  # noqa: D102
        if self.breakaway > 0.0 and self.coulomb == 0.0:
            raise section.make_refusal("breakaway", "come with a coulomb friction", self.breakaway)

    def check_gear(self, gear: Gear | None, joint: Section) -> None:
        """Refuse a law whose torque depends on a torque that this joint's gear does not have.

        Args:
            gear: of the joint; None: it has no motor.
            joint: its section.
        """


@register_part
class LinkFriction(Friction):
    """Friction at the link."""

    section = "friction"


class OfRotor(Friction):
    """Any law of friction at the motor's shaft."""

    section = "motor.friction"
    shaft = "rotor"

    @property
    def cxx_type(self) -> str:  # noqa: D102
        return f"arm::RotorFriction<{super().cxx_type}>"

    def write_initialiser(self, joint: str, places: Mapping[str, str]) -> str:  # noqa: D102
        return f"{self.cxx_type}{{{self.write_law(joint, places)[1]}}}"

    def write_law(self, joint: str, places: Mapping[str, str]) -> tuple[str, str]:
        """Return type and initialiser of the law alone."""
        kind = super().cxx_type
        members = ", ".join(
            f".{name} = {value}" for name, value in self.list_members(joint, places)
        )
        return kind, f"{kind}{{{members}}}"


@register_part
class RotorFriction(OfRotor):
    """Friction at the motor's shaft."""
