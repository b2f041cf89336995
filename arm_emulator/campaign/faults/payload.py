"""The tool carries another mass."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from arm_emulator.base.number import number
from arm_emulator.campaign.fault import Fault
from arm_emulator.machine.session import Session


@dataclass(frozen=True, kw_only=True)
class Payload(Fault):
    """The tool takes up or drops mass; its speed stays."""

    kind: ClassVar[str] = "payload"
    varied: ClassVar[tuple[str, ...]] = ("payload.mass",)

    mass: float = number("kg", at_least=0.0, text="of the payload from then on")

    @classmethod
    def needs(cls, scene: Mapping[str, Any]) -> dict[str, Any]:
        """Return a payload of no mass where the scene has none."""
        return {} if "payload" in scene else {"payload": 0.0}

    def begin(self, session: Session) -> Callable[[], None]:
        """Take mass up, or drop some."""
        before = session.plant.parameters["payload.mass"]
        session.set_varied("payload.mass", self.mass)
        return lambda: session.set_varied("payload.mass", before)
