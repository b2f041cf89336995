"""Sensors with an amplifier and a converter: base of those of any quantity."""

import dataclasses
import zlib
from collections.abc import Mapping
from functools import partial
from typing import ClassVar, Self

from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.fault import (
    FALLS,
    HOLDS,
    STUCK,
    Fault,
    bound_rise,
    bound_share,
    declare_sensor_fault,
)
from arm_emulator.machine.parts.measuring.encoder import DELAY
from arm_emulator.machine.parts.part import Part, PartNumber, number

JOINT_CHANNELS = 4  # of the encoders, the current sensor and the torque sensor of a joint
MAX_JOINTS = 4096  # that draws keep apart
LARGEST_ERROR = 1e6  # that a sensor adds, in the unit of its quantity


class AnalogConverter(Part):
    """(1 + gain_error) x + drift t + noise, limited and rounded. What is None is absent."""

    header = "measuring/analog_sensor.hpp"
    cxx = "AnalogSensor"
    unit: ClassVar[str]  # of the quantity
    zero: ClassVar[str] = "offset"  # the key of its reading where the quantity is 0

    gain_error: float | None = number(
        "gain_error", "1", ends=(-1.0, 1.0), default=None, text="0.01: reads 1 % high"
    )
    noise: float | None = number(
        "noise", "", ends=(0.0, LARGEST_ERROR), default=None, text="standard deviation, white"
    )
    range: float | None = number(
        "range", "", above=0.0, default=None, text="larger readings are reported as ±`range`"
    )
    resolution: float | None = number(
        "resolution", "", above=0.0, default=None, text="readings are multiples of it"
    )
    held: float | None = number(
        "held",
        "1",
        ends=(0.0, 1.0),
        default=None,
        text="probability that a reading is lost and the previous one stands",
    )
    drift: float | None = number(
        "drift",
        "/s",
        ends=(-LARGEST_ERROR, LARGEST_ERROR),
        default=None,
        text="growth of the offset; a reset removes it",
    )

    @classmethod
    def list_numbers(cls) -> dict[str, PartNumber]:
        """Return the declared numbers by key; without a unit they are in that of the quantity."""
        units = {"": cls.unit, "/s": f"{cls.unit}/s"}
        return {
            key: dataclasses.replace(number, unit=units.get(number.unit, number.unit))
            for key, number in super().list_numbers().items()
        }

    @classmethod
    def list_faults(cls) -> tuple[Fault, ...]:  # noqa: D102
        about = cls.section.replace("_", " ")
        kind = partial(declare_sensor_fault, cls.section, about, of=cls.owners)
        return (
            kind("offset", "the amplifier's zero moves", cls.zero,
                 bound_rise(cls.unit, 0.5, LARGEST_ERROR, signed=True)),
            kind("drifts", "the amplifier's zero drifts", "drift",
                 bound_rise(f"{cls.unit}/s", 0.5, LARGEST_ERROR, signed=True)),
            kind("gain", "the amplifier's gain is off", "gain_error",
                 bound_rise("1", 0.1, 1.0, signed=True)),
            kind("stuck", STUCK, "held", bound_share(), HOLDS),
            kind("noisy", "the shield is broken", "noise",
                 bound_rise(cls.unit, 0.1, LARGEST_ERROR)),
            kind("saturates", "the amplifier's range falls", "range",
                 bound_share(0.9, 0.999), FALLS, absent=None),
        )  # fmt: skip

    def list_members(self, joint: str, places: Mapping[str, str]) -> list[tuple[str, str]]:  # noqa: D102
        return [("present", "true"), *super().list_members(joint, places)]


class AnalogSensor(AnalogConverter):
    """A sensor of one quantity of a joint, with an offset and a delay.

    A class that inherits it and is registered (`register_part`) is a section of joints.
    """

    reads: ClassVar[str]  # the values measured, by joint, in C++: see sensors.hpp
    field: ClassVar[str] = "reading"  # where arm.h has the readings, of `Field` there
    of: ClassVar[str] = "motor"  # the section of a joint that it needs; none: it stands alone
    channel: ClassVar[int | None] = None  # its place among the draws of a joint, if it has one

    keys = (DELAY,)

    @classmethod
    def list_streams(cls) -> tuple[int, int]:
        """Return its noise stream at joint 0, and the increment per joint."""
        if cls.channel is not None:
            return cls.channel, JOINT_CHANNELS
        # By its name, so that other sensors in a scene or a later version change nothing.
        return MAX_JOINTS * (1 + zlib.crc32(cls.section.encode()) % 2**18), 1

    offset: float | None = number(
        "offset",
        "",
        ends=(-LARGEST_ERROR, LARGEST_ERROR),
        default=None,
        text="added to the reading",
    )
    delay: int = 0  # servo periods

    @classmethod
    def read_section(cls, section: Section) -> Self:  # noqa: D102
        return cls(delay=section.read_integer(DELAY), **cls.read_numbers(section))

    def list_members(self, joint: str, places: Mapping[str, str]) -> list[tuple[str, str]]:  # noqa: D102
        return [*super().list_members(joint, places), ("delay", str(self.delay))]
