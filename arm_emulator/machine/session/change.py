"""Changes of a machine between two ticks."""

from dataclasses import dataclass

from arm_emulator.machine.plant.external_wrench import ExternalWrench
from arm_emulator.machine.session.session import Session


@dataclass(frozen=True)
class NumberChange:
    """A number that the scene lists as varied gets another value.

    Attributes:
        name: of the number.
        value: of it; None: the one that it has in a sound machine.
    """

    name: str
    value: float | None

    @property
    def quantity(self) -> str:
        """Its number: of changes of the same, the newest holds."""
        return self.name

    def make(self, session: Session) -> None:
        """Set it in a machine."""
        assert self.value is not None
        session.set_varied(self.name, self.value)


@dataclass(frozen=True)
class WrenchChange:
    """An external wrench acts on a link from now on."""

    link: str
    wrench: ExternalWrench

    @property
    def quantity(self) -> str:
        """The wrench on its link: of changes of the same, the newest holds."""
        return f"wrench on {self.link}"

    def make(self, session: Session) -> None:
        """Set it in a machine."""
        session.set_external_wrench(self.link, self.wrench)


@dataclass(frozen=True)
class PowerChange:
    """The drives get power, or lose it."""

    on: bool

    @property
    def quantity(self) -> str:
        """The power: of changes of the same, the newest holds."""
        return "power"

    def make(self, session: Session) -> None:
        """Set it in a machine."""
        session.powered = self.on


Change = NumberChange | WrenchChange | PowerChange
