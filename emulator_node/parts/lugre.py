"""Friction by bristles that bend before they slip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from emulator_node.parts.part import Number, Part


@dataclass(frozen=True, kw_only=True)
class LuGre(Part):
    """Where the motion before sliding matters: positioning, reversals, stick-slip."""

    header = "lugre.hpp"
    cxx = "LuGre"
    place: ClassVar[str]

    coulomb: Annotated[float, Number("Dc", "N m", above=0.0)]
    breakaway: Annotated[float, Number("Ds", "N m", follows="coulomb")] = 0.0
    stribeck: Annotated[float, Number("vs", "rad/s", above=0.0)] = 0.1
    bristle_stiffness: Annotated[float, Number("s0", "N m/rad", above=0.0)]
    bristle_damping: Annotated[float, Number("s1", "N m s/rad", at_least=0.0)] = 0.0

    @property
    def cxx_type(self) -> str:  # noqa: D102
        return f"arm::{self.cxx}<arm::Place::{self.place}>"


@dataclass(frozen=True, kw_only=True)
class LinkLuGre(LuGre):
    """At the link."""

    section = "lugre"
    place = "link"


@dataclass(frozen=True, kw_only=True)
class RotorLuGre(LuGre):
    """At the motor's shaft."""

    section = "motor.lugre"
    place = "rotor"
