"""Sensors with an amplifier and a converter: what those of any quantity have in common."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Self

from arm_emulator.base.section import Section
from arm_emulator.machine.parts.encoder import read_delay
from arm_emulator.machine.parts.part import Number, Part

LARGEST_ERROR = 1e6  # that a sensor adds, in the unit of its quantity


@dataclass(frozen=True, kw_only=True)
class Converter(Part):
    """(1 + gain_error) x + noise, limited and rounded. What is None is absent."""

    header = "analog_sensor.hpp"
    cxx = "AnalogSensor"
    unit: ClassVar[str]  # of the quantity

    gain_error: Annotated[float | None, Number("gain_error", "1", at_least=-1.0, at_most=1.0)] = (
        None
    )
    noise: Annotated[float | None, Number("noise", "", at_least=0.0, at_most=LARGEST_ERROR)] = None
    range: Annotated[float | None, Number("range", "", above=0.0)] = None
    resolution: Annotated[float | None, Number("resolution", "", above=0.0)] = None

    @classmethod
    def numbers(cls) -> dict[str, Number]:
        """Return the declared numbers by key; without a unit they are in that of the quantity."""
        declared = super().numbers().items()
        return {key: dataclasses.replace(one, unit=one.unit or cls.unit) for key, one in declared}

    def members(self, joint: str, places: Mapping[str, str]) -> list[tuple[str, str]]:  # noqa: D102
        return [("present", "true"), *super().members(joint, places)]


@dataclass(frozen=True, kw_only=True)
class AnalogSensor(Converter):
    """A sensor of one quantity, with an offset and a delay."""

    offset: Annotated[
        float | None, Number("offset", "", at_least=-LARGEST_ERROR, at_most=LARGEST_ERROR)
    ] = None
    delay: int = 0  # servo periods

    @classmethod
    def read(cls, section: Section) -> Self:  # noqa: D102
        return cls(delay=read_delay(section), **cls.read_numbers(section))

    def members(self, joint: str, places: Mapping[str, str]) -> list[tuple[str, str]]:  # noqa: D102
        return [*super().members(joint, places), ("delay", str(self.delay))]
