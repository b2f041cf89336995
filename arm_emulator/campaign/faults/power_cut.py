"""The drives lose their power."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from arm_emulator.campaign.fault import Fault
from arm_emulator.machine.session import Session


@dataclass(frozen=True, kw_only=True)
class PowerCut(Fault):
    """The drives lose their power; brakes close."""

    kind: ClassVar[str] = "power_cut"

    def begin(self, session: Session) -> Callable[[], None]:
        """Cut the power."""
        session.powered = False
        return lambda: setattr(session, "powered", True)
