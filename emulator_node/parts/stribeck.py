"""Friction that falls as a shaft begins to slide."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from emulator_node.parts.friction import Friction, LinkFriction, OfRotor
from emulator_node.parts.part import Number


@dataclass(frozen=True, kw_only=True)
class Stribeck(Friction):
    """From `breakaway` at rest to `coulomb`, by exp(-(speed / stribeck)^2)."""

    header = "stribeck.hpp"
    cxx = "Stribeck"
    told_by = ("stribeck",)

    stribeck: Annotated[float, Number("vs", "rad/s", above=0.0)] = field()


@dataclass(frozen=True, kw_only=True)
class LinkStribeck(Stribeck, LinkFriction):
    """At the link."""


@dataclass(frozen=True, kw_only=True)
class RotorStribeck(OfRotor, Stribeck):
    """At the motor's shaft."""
