"""Changes of a machine between two ticks."""

from __future__ import annotations

from dataclasses import dataclass

from arm_emulator.machine.external_wrench import ExternalWrench
from arm_emulator.machine.session import Session


@dataclass(frozen=True)
class NumberChange:
    """A number that the scene lists as varied gets another value.

    Attributes:
        name: of the number.
        value: of it; None: the one that it had before its newest change.
    """

    name: str
    value: float | None

    def make(self, session: Session) -> None:
        """Set it in a machine."""
        assert self.value is not None
        session.set_varied(self.name, self.value)


@dataclass(frozen=True)
class WrenchChange:
    """An external wrench acts on a link from now on."""

    link: str
    wrench: ExternalWrench

    def make(self, session: Session) -> None:
        """Set it in a machine."""
        session.set_external_wrench(self.link, self.wrench)


@dataclass(frozen=True)
class PowerChange:
    """The drives get power, or lose it."""

    on: bool

    def make(self, session: Session) -> None:
        """Set it in a machine."""
        session.powered = self.on


Change = NumberChange | WrenchChange | PowerChange
