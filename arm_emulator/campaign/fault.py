"""A fault: what goes wrong with a machine, from one tick to another.

A new kind is a file in `faults`: a frozen dataclass that declares its numbers, and how it begins
and ends. Files, refusals, docs and what can vary follow from it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from arm_emulator.base.number import number
from arm_emulator.base.section import Section
from arm_emulator.machine.scene import Scene
from arm_emulator.machine.session import Session


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Base of all faults.

    Attributes:
        kind: its name in files.
        varied: numbers of the scene that it sets, which must be data of the machine.
    """

    kind: ClassVar[str] = ""
    varied: ClassVar[tuple[str, ...]] = ()

    at: float = number("s", at_least=0.0, text="when it begins")
    lasting: float = number("s", above=0.0, default=math.inf, text="how long; to the end if absent")

    @classmethod
    def read(cls, section: Section) -> Self:
        """Return the one that a section states.

        Raises:
            Refusal: a number out of its range.
        """
        return cls(**section.numbers(cls), **cls.others(section))

    @classmethod
    def others(cls, section: Section) -> dict[str, Any]:
        """Return what a section states beside numbers."""
        return {}

    @classmethod
    def needs(cls, scene: Mapping[str, Any]) -> dict[str, Any]:
        """Return what a scene file that has these keys lacks for it, as `load_scene` takes it."""
        return {}

    def check(self, scene: Scene, where: str) -> None:
        """Refuse what this scene cannot have.

        Raises:
            Refusal: see above.
        """

    def begin(self, session: Session) -> Callable[[], None]:
        """Let it begin, between two ticks; return what ends it."""
        raise NotImplementedError
