"""A fault that the scene lists, by its name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from arm_emulator.extension.base import Refusal, Section, number
from arm_emulator.extension.machine import Change, NumberChange, Scene
from arm_emulator_campaign.definition.fault import Fault, register_fault


@register_fault
@dataclass(frozen=True, kw_only=True)
class Machine(Fault):
    """A fault of the machine that the scene lists in `faults`, such as elbow.encoder_slips.

    Attributes:
        fault: its name in the scene.
    """

    kind: ClassVar[str] = "machine"

    fault: str
    magnitude: float = number("", ends=(-1e9, 1e9), text="in the unit of the fault")

    @classmethod
    def read_attributes(cls, section: Section) -> dict[str, Any]:
        """Return the name."""
        return {"fault": section.read_text("fault")}

    def check_scene(self, scene: Scene, where: str) -> None:
        """Refuse what the scene does not list, or a magnitude out of its range."""
        listed = {fault.name: fault.varied.number for fault in scene.faults}
        if self.fault not in listed:
            listed_names = ", ".join(listed) or f"none, set: {{faults: [{self.fault}]}} lists it"
            raise Refusal(where, "fault", "be listed by the scene", self.fault, listed_names)
        listed[self.fault].check_value(where, self.magnitude, "magnitude")

    def make_begin_change(self, scene: Scene) -> Change:
        """Return its magnitude."""
        return NumberChange(f"faults.{self.fault}", self.magnitude)

    def make_end_change(self) -> Change:
        """Return that it is not there."""
        return NumberChange(f"faults.{self.fault}", 0.0)
