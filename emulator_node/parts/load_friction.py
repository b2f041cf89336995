"""Friction that grows with the torque of the gear."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from emulator_node.parts.friction import Friction, LinkFriction, OfRotor
from emulator_node.parts.part import Number


@dataclass(frozen=True, kw_only=True)
class LoadFriction(Friction):
    """Beside friction of another kind, `load` times the gear's torque on that shaft."""

    header = "load_friction.hpp"
    cxx = "LoadFriction"
    told_by = ("load",)

    stribeck: Annotated[float | None, Number("vs", "rad/s", above=0.0)] = None
    load: Annotated[float, Number("mu", "N m/(N m)", at_least=0.0, at_most=10.0)] = field()


@dataclass(frozen=True, kw_only=True)
class LinkLoadFriction(LoadFriction, LinkFriction):
    """At the link."""


@dataclass(frozen=True, kw_only=True)
class RotorLoadFriction(OfRotor, LoadFriction):
    """At the motor's shaft."""
