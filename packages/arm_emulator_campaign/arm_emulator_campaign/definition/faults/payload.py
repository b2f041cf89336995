"""The tool carries another mass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from arm_emulator.extension.base import Section, number
from arm_emulator.extension.machine import Change, NumberChange, Scene
from arm_emulator_campaign.definition.fault import Fault, register_fault


@register_fault
@dataclass(frozen=True, kw_only=True)
class Payload(Fault):
    """The tool takes up or drops mass; its speed stays."""

    kind: ClassVar[str] = "payload"
    mass: float = number("kg", at_least=0.0, text="of the payload from then on")

    @classmethod
    def list_set_numbers(cls, section: Section) -> Sequence[str]:
        """Return the payload's mass."""
        return ("payload.mass",)

    @classmethod
    def list_needed_keys(cls, scene: Mapping[str, Any]) -> dict[str, Any]:
        """Return a payload of no mass where the scene has none."""
        return {} if "payload" in scene else {"payload": 0.0}

    def make_begin_change(self, scene: Scene) -> Change:
        """Return the mass."""
        return NumberChange("payload.mass", self.mass)

    def make_end_change(self) -> Change:
        """Return the mass before."""
        return NumberChange("payload.mass", None)
