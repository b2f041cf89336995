"""Common base of all parts of a drive: numbers, each declared once.

A part is a frozen dataclass whose attributes are called as their keys in the scene::

    resistance: float = number("R", "ohm", above=0.0)
    inductance: float = number("L", "H", at_least=0.0, default=0.0)

Reading them with refusals, the C++ of the part, and what a scene may list as varied follow from
that.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self, dataclass_transform

from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.number import (
    REQUIRED,
    Ends,
    Number,
    build_bounds,
    declare_field,
    list_numbers,
)
from arm_emulator.base.validation.section import Section
from arm_emulator.machine import cxx_literals
from arm_emulator.machine.parts.fault import Fault
from arm_emulator.machine.parts.key import Key
from arm_emulator.machine.parts.output import Output
from arm_emulator.machine.parts.shaft_motion import ShaftMotion
from arm_emulator.machine.varied import Varied


@dataclass(frozen=True, kw_only=True)
class PartNumber(Number):
    """A number of a part, in the unit that it has at a revolute joint.

    Attributes:
        symbol: the member of the C++ part. The members stand there in the order of the attributes.
        follows: another key of the part. The number is at least that one, equals it if it is not
            given, and keeps its ratio to it where that one is varied.
        varied: whether a scene may list it as varied, unless it is whole or follows another one.
        prior: whether identification looks for it: "known" roughly beforehand, from the scene, or
            "unknown".
        excitation: what a record must have to show it, in a few words, where not every motion does.
        absent: what holds where it is left out and its default is None, in a few words.
    """

    symbol: str
    follows: str | None = None
    varied: bool = True
    prior: str = ""
    excitation: str = ""
    absent: str = "none"


def number(
    symbol: str, unit: str, *, default: Any = REQUIRED, ends: Ends = (None, None), **declared: Any
) -> Any:
    """Return a dataclass field that is a number of a part, see `PartNumber`; `ends`: bounds."""
    bounds = build_bounds(ends)
    return declare_field(PartNumber("", unit, symbol=symbol, default=default, **bounds, **declared))


@dataclass_transform(
    kw_only_default=True, frozen_default=True, field_specifiers=(dataclasses.field,)
)
class Declared:
    """Base of classes that are frozen dataclasses with keywords, by what they inherit."""

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, kw_only=True)(cls)


class Part(Declared):
    """A part of a joint's drive; see the top of this file."""

    owners: ClassVar[str] = "joints"  # the section of the scene that has whom it belongs to
    section: ClassVar[str]  # where it stands below its owner's, such as "motor.friction"
    header: ClassVar[str]  # that has the C++ part
    cxx: ClassVar[str]  # and its name
    keys: ClassVar[tuple[Key | Number, ...]] = ()  # beside its numbers
    shaft: ClassVar[str] = "link"  # on which it acts: of the rotor or of the link
    # Keys of a loop beside the gear's spring: its size, in which its torque is linear, and shape.
    loop_keys: ClassVar[tuple[str, ...]] = ()
    outputs: ClassVar[tuple[Output, ...]] = ()  # what parts of this class may report
    truths: ClassVar[tuple[Output, ...]] = ()  # and what only the emulator knows, by arm_truth

    @classmethod
    def name_place(cls) -> str:
        """Return the name of which a registered part is the only owner: its place in scenes."""
        return f"{cls.owners}.NAME.{cls.section}"

    @property
    def reports(self) -> tuple[Output, ...]:
        """Outputs of this part, among `outputs`."""
        return self.outputs

    @classmethod
    def list_faults(cls) -> tuple[Fault, ...]:
        """Return the kinds of faults of such a part, beside those of the package `faults`."""
        return ()

    @property
    def can_stick(self) -> bool:
        """Whether it holds a shaft exactly at rest, up to a breakaway torque."""
        return False

    @classmethod
    def list_numbers(cls) -> dict[str, PartNumber]:
        """Return the declared numbers by key."""
        return list_numbers(cls)

    @classmethod
    def read_section(cls, section: Section) -> Self:
        """Return the part that a section describes.

        Raises:
            Refusal: a number breaks its rule.
        """
        values = cls.read_numbers(section)
        part = cls(**values)
        part.check_numbers(section)
        return part

    @classmethod
    def read_numbers(cls, section: Section) -> dict[str, Any]:
        """Return the values of the declared numbers by key."""
        values: dict[str, Any] = {}
        for key, number in cls.list_numbers().items():
            if number.follows is not None:
                reference = values[number.follows]
                number = dataclasses.replace(number, default=reference, at_least=reference)
            values[key] = section.read_number(number)
        return values

    def check_numbers(self, section: Section) -> None:
        """Refuse inconsistent numbers."""

    def compute_effort(self, motion: ShaftMotion) -> Array | None:
        """Return the torque (K,) that a motion of its shaft takes because of this part [N m].

        The motor must supply it. None: the motion alone does not determine it; callers refuse the
        part.
        """
        return None

    def compute_loop_torque(self, twist: Array) -> Array:
        """Return the torque on the link (K,) [N m] of a part that has a loop.

        Args:
            twist: of the gear at the link, a path from where it was never bent (K,) [rad].
        """
        raise NotImplementedError

    def replace_numbers(self, **values: float) -> Self:
        """Return the part with other numbers; those that follow one keep their ratio to it."""
        for key, number in self.list_numbers().items():
            if number.follows in values and key not in values:
                reference = getattr(self, number.follows)
                ratio = getattr(self, key) / reference if reference > 0.0 else 1.0
                values[key] = ratio * values[number.follows]
        return dataclasses.replace(self, **values)

    def list_variable_numbers(self, joint: str) -> list[Varied]:
        """Return the numbers that a scene may list as varied."""
        of = f"{self.owners}.{joint}.{self.section}"
        return [
            Varied(self.list_numbers()[key].rename(f"{of}.{key}"), value)
            for key, value in self.list_own_numbers().items()
            if value is not None
        ]

    def list_own_numbers(self) -> dict[str, float | None]:
        """Return the numbers that may be data of each machine, by key; None: it is left out."""
        return {
            key: getattr(self, key)
            for key, number in self.list_numbers().items()
            if number.varied and not number.whole and number.follows is None
        }

    def list_fault_numbers(self) -> dict[str, float | None]:
        """Return the numbers that faults may change, by key: its own, and states of no section."""
        return self.list_own_numbers()

    def list_headers(self, joint: str, places: Mapping[str, str]) -> tuple[str, ...]:
        """Return the headers that its C++ needs; arguments as of `write_initialiser`."""
        return (self.header,)

    @property
    def cxx_type(self) -> str:
        """The C++ type."""
        return f"arm::{self.cxx}"

    def write_initialiser(self, joint: str, places: Mapping[str, str]) -> str:
        """Return the part in C++.

        Args:
            joint: the joint's name.
            places: where the values of varied numbers stand, by their name.
        """
        members = ", ".join(
            f".{name} = {value}" for name, value in self.list_members(joint, places)
        )
        return f"{self.cxx_type}{{{members}}}"

    def list_members(self, joint: str, places: Mapping[str, str]) -> list[tuple[str, str]]:
        """Return the members of the C++ part and their values, in C++'s order."""
        members = []
        for key, number in self.list_numbers().items():
            value = getattr(self, key)
            place = places.get(f"{self.owners}.{joint}.{self.section}.{number.follows or key}")
            if value is None and (place is None or number.follows is not None):
                continue
            if place is None:
                text = cxx_literals.format_number(value)
            elif number.follows is None:
                text = place
            else:
                reference = getattr(self, number.follows)
                ratio = value / reference if reference > 0.0 else 1.0
                text = f"{cxx_literals.format_number(ratio)} * {place}"
            members.append((number.symbol, text))
        return members
