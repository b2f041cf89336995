"""What all parts of a drive have in common: numbers, each declared once.

A part is a frozen dataclass whose attributes are called as their keys in the scene::

    resistance: Annotated[float, Number("R", "ohm", above=0.0)]
    inductance: Annotated[float, Number("L", "H", at_least=0.0)] = 0.0

Reading them with refusals, the C++ of the part, and what a scene may list as varied follow from
that.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, Self, get_type_hints

from arm_emulator.base.section import LARGEST, SMALLEST, Section
from arm_emulator.machine import cxx_literals
from arm_emulator.machine.chain import Array
from arm_emulator.machine.parts.output import Output
from arm_emulator.machine.parts.resting import AtRest, Share
from arm_emulator.machine.parts.shaft_motion import ShaftMotion
from arm_emulator.machine.varied import Varied


@dataclass(frozen=True)
class Number:
    """A number of a part. It must be given unless the attribute has a default.

    Attributes:
        symbol: the member of the C++ part. The members stand there in the order of the attributes.
        unit: of a revolute joint.
        above: the number is larger.
        at_least, at_most: the number is within.
        follows: another key of the part. The number is at least that one, equals it if it is not
            given, and keeps its ratio to it where that one is varied.
        in_size: whether the bounds are those of the number's size, and it may be negative.
        varied: whether a scene may list it as varied, unless it follows another one.
        whole: whether it is a whole number, from `at_least` to `at_most`; such a one is not varied.
        sought: whether identification looks for it: "known" roughly beforehand, from the scene, or
            "unknown".
    """

    symbol: str
    unit: str
    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    follows: str | None = None
    in_size: bool = False
    varied: bool = True
    whole: bool = False
    sought: str = ""

    @property
    def least(self) -> float:
        """The smallest value that it may be given while a machine runs."""
        if self.above is not None:
            return self.above or SMALLEST
        return -LARGEST if self.at_least is None else self.at_least

    @property
    def most(self) -> float:
        """The largest."""
        return LARGEST if self.at_most is None else self.at_most


@dataclass(frozen=True)
class Part:
    """A part of a joint's drive; see the top of this file."""

    owners: ClassVar[str] = "joints"  # the section of the scene that has whom it belongs to
    section: ClassVar[str]  # where it stands below its owner's, such as "motor.friction"
    header: ClassVar[str]  # that has the C++ part
    cxx: ClassVar[str]  # and its name
    shaft: ClassVar[str] = "link"  # on which it acts: of the rotor or of the link
    outputs: ClassVar[tuple[Output, ...]] = ()  # what parts of this class may report
    truths: ClassVar[tuple[Output, ...]] = ()  # and what only the emulator knows, by arm_truth

    @property
    def reports(self) -> tuple[Output, ...]:
        """What this part reports, of `outputs`."""
        return self.outputs

    @property
    def sticks(self) -> bool:
        """Whether a shaft at rest is held exactly, until the torque on it is large enough."""
        return False

    def rests(self, at: AtRest) -> Share | str:
        """Return what this part leaves of a target at rest, or why that is not known.

        It is asked twice: for its torque, and then, with all torques known, for the rest.
        """
        return "states no share"

    @classmethod
    def numbers(cls) -> dict[str, Number]:
        """Return the declared numbers by key."""
        this: type = cls  # mypy takes a class of its own for not hashable
        return _numbers(this)

    @classmethod
    def read(cls, section: Section) -> Self:
        """Return the part that a section describes.

        Raises:
            Refusal: a number breaks its rule.
        """
        values = cls.read_numbers(section)
        part = cls(**values)
        part.check(section)
        return part

    @classmethod
    def read_numbers(cls, section: Section) -> dict[str, Any]:
        """Return the values of the declared numbers by key."""
        values: dict[str, Any] = {}
        defaults = {field.name: field.default for field in dataclasses.fields(cls)}
        for key, one in cls.numbers().items():
            default, at_least = defaults[key], one.at_least
            if one.follows is not None:
                default = at_least = values[one.follows]
            if default is not dataclasses.MISSING and not section.has(key):
                values[key] = default
            elif one.whole:
                values[key] = section.integer(key, at_least=int(one.least), at_most=int(one.most))
            else:
                values[key] = section.number(
                    key,
                    one.unit,
                    above=one.above,
                    at_least=at_least,
                    at_most=one.at_most,
                    in_size=one.in_size,
                )
        return values

    def check(self, section: Section) -> None:
        """Refuse numbers that do not go together."""

    def effort(self, motion: ShaftMotion) -> Array | None:
        """Return the torque (K,) that a motion of its shaft takes because of this part [N m].

        So much more the motor must give. None: the motion alone does not determine it, and what
        asks refuses the part.
        """
        return None

    def with_numbers(self, **values: float) -> Self:
        """Return the part with other numbers; those that follow one keep their ratio to it."""
        for key, one in self.numbers().items():
            if one.follows in values and key not in values:
                leader = getattr(self, one.follows)
                ratio = getattr(self, key) / leader if leader > 0.0 else 1.0
                values[key] = ratio * values[one.follows]
        return dataclasses.replace(self, **values)

    def could_vary(self, joint: str) -> list[Varied]:
        """Return the numbers that a scene may list as varied."""
        return [
            Varied(f"{self.owners}.{joint}.{self.section}.{key}", value, one.least, one.most)
            for key, one in self.numbers().items()
            if one.varied
            and not one.whole
            and one.follows is None
            and (value := getattr(self, key)) is not None
        ]

    @property
    def cxx_type(self) -> str:
        """The C++ type."""
        return f"arm::{self.cxx}"

    def initialiser(self, joint: str, places: Mapping[str, str]) -> str:
        """Return the part in C++.

        Args:
            joint: the joint's name.
            places: where the values of varied numbers stand, by their name.
        """
        members = ", ".join(f".{name} = {value}" for name, value in self.members(joint, places))
        return f"{self.cxx_type}{{{members}}}"

    def members(self, joint: str, places: Mapping[str, str]) -> list[tuple[str, str]]:
        """Return the members of the C++ part and their values, in C++'s order."""
        members = []
        for key, one in self.numbers().items():
            value = getattr(self, key)
            place = places.get(f"{self.owners}.{joint}.{self.section}.{one.follows or key}")
            if value is None:
                continue
            if place is None:
                text = cxx_literals.number(value)
            elif one.follows is None:
                text = place
            else:
                leader = getattr(self, one.follows)
                ratio = value / leader if leader > 0.0 else 1.0
                text = f"{cxx_literals.number(ratio)} * {place}"
            members.append((one.symbol, text))
        return members


@cache  # a scene asks once for every part of every joint
def _numbers(part: type) -> dict[str, Number]:
    hints = get_type_hints(part, include_extras=True)
    return {
        field.name: one
        for field in dataclasses.fields(part)
        for one in getattr(hints[field.name], "__metadata__", ())
        if isinstance(one, Number)
    }
