"""Changes of a machine between two ticks."""

from __future__ import annotations

from dataclasses import dataclass

from arm_emulator.machine.external_wrench import ExternalWrench


@dataclass(frozen=True)
class NumberChange:
    """A number that the scene lists as varied gets another value.

    Attributes:
        name: of the number.
        value: of it; None: the one that it had before its newest change.
    """

    name: str
    value: float | None


@dataclass(frozen=True)
class WrenchChange:
    """An external wrench acts on a link from now on."""

    link: str
    wrench: ExternalWrench


@dataclass(frozen=True)
class PowerChange:
    """The drives get power, or lose it."""

    on: bool


Change = NumberChange | WrenchChange | PowerChange
