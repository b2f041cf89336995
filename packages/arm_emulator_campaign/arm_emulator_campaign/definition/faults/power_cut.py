"""The drives lose their power."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from arm_emulator.extension.machine import Change, PowerChange, Scene
from arm_emulator_campaign.definition.fault import Fault, register_fault


@register_fault
@dataclass(frozen=True, kw_only=True)
class PowerCut(Fault):
    """The drives lose their power; brakes close."""

    kind: ClassVar[str] = "power_cut"

    def make_begin_change(self, scene: Scene) -> Change:
        """Return that the power is cut."""
        return PowerChange(False)

    def make_end_change(self) -> Change:
        """Return that it comes back."""
        return PowerChange(True)
