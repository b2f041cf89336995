"""Gears whose teeth are not quite where they should be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from emulator_node import cxx_literals
from emulator_node.parts.elastic_gear import ElasticGear
from emulator_node.section import Section

MOST = 16  # waves of a shaft
LARGEST_ORDER = 1e5

# Waves per rad of the shaft, amplitude at the link [rad], phase [rad].
Wave = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class KinematicErrorGear(ElasticGear):
    """An elastic gear whose twist has an error that goes with the angles of motor and link."""

    header = "kinematic_error.hpp"
    cxx = "KinematicErrorGear"
    told_by: ClassVar[tuple[str, ...]] = ("stiffness", "kinematic_error")

    motor: tuple[Wave, ...] = ()
    link: tuple[Wave, ...] = ()

    @classmethod
    def read_numbers(cls, section: Section) -> dict[str, Any]:  # noqa: D102
        values = super().read_numbers(section)
        if (errors := section.section("kinematic_error")) is not None:
            values |= {shaft: _waves(errors, shaft) for shaft in ("motor", "link")}
        return values

    def check(self, section: Section) -> None:  # noqa: D102
        # A steeper error would turn the gear back at some angles.
        for shaft, most in (("motor", abs(self.ratio)), ("link", 1.0)):
            waves: tuple[Wave, ...] = getattr(self, shaft)
            steepest = sum(abs(order * amplitude) for order, amplitude, _ in waves)
            if steepest > 0.9 * most:
                rule = f"have order times amplitude sum up to at most {0.9 * most:g}"
                raise section.refusal(f"kinematic_error.{shaft}", rule, f"{steepest:g}")

    @property
    def cxx_type(self) -> str:  # noqa: D102
        return f"arm::{self.cxx}<{len(self.motor)}, {len(self.link)}>"

    def members(self, joint: str, places: Mapping[str, str]) -> list[tuple[str, str]]:  # noqa: D102
        waves = [
            (shaft, "{{" + ", ".join("{" + ", ".join(map(cxx_literals.number, one)) + "}"
                                     for one in getattr(self, shaft)) + "}}")
            for shaft in ("motor", "link")
            if getattr(self, shaft)
        ]  # fmt: skip
        return super().members(joint, places) + waves


def _waves(section: Section, shaft: str) -> tuple[Wave, ...]:
    """Return the waves of a shaft that a section lists."""
    entries = section.entries(shaft)
    if len(entries) > MOST:
        raise section.refusal(shaft, f"have at most {MOST} waves", len(entries))
    waves = []
    for entry in entries:
        if not isinstance(entry, list) or len(entry) not in (2, 3):
            rule = "list waves of [order, amplitude in rad] or [order, amplitude, phase]"
            raise section.refusal(shaft, rule, repr(entry))
        numbers = [*entry, 0.0][:3]
        for value, most in zip(numbers, (LARGEST_ORDER, 1e3, 1e4), strict=True):
            sound = isinstance(value, int | float) and not isinstance(value, bool)
            if not sound or not abs(value) <= most:
                rule = (
                    "list waves of numbers, order up to 1e5, amplitude up to 1e3, phase up to 1e4"
                )
                raise section.refusal(shaft, rule, repr(entry))
        if numbers[0] <= 0.0:
            raise section.refusal(shaft, "have waves of orders > 0", repr(entry))
        waves.append((float(numbers[0]), float(numbers[1]), float(numbers[2])))
    return tuple(waves)
