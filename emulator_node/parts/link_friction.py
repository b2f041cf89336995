"""Friction at the link."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from emulator_node.parts.part import Number, Part
from emulator_node.section import Section


@dataclass(frozen=True, kw_only=True)
class LinkFriction(Part):
    """Viscous, and Coulomb's: `coulomb` while the joint slides, `breakaway` at rest."""

    section = "friction"
    header = "link_friction.hpp"
    cxx = "LinkFriction"

    viscous: Annotated[float, Number("Dl", "N m s/rad", at_least=0.0)] = 0.0
    coulomb: Annotated[float, Number("Dc", "N m", at_least=0.0)] = 0.0
    breakaway: Annotated[float, Number("Ds", "N m", follows="coulomb")] = 0.0

    def check(self, section: Section) -> None:  # noqa: D102
        if self.breakaway > 0.0 and self.coulomb == 0.0:
            raise section.refusal("breakaway", "come with a coulomb friction", self.breakaway)
