"""A number of the machine changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from arm_emulator.extension.base import Refusal, Section, number
from arm_emulator.extension.machine import LARGEST_SEED, Change, NumberChange, Scene
from arm_emulator_campaign.definition.fault import Fault, register_fault


@register_fault
@dataclass(frozen=True, kw_only=True)
class NumberOfScene(Fault):
    """Another value of any number of the scene that can vary: friction, stiffness, `seed`.

    Attributes:
        name: of the number.
    """

    kind: ClassVar[str] = "number"

    name: str
    value: float = number(
        "", ends=(-LARGEST_SEED, LARGEST_SEED), text="from then on, in the unit of the number"
    )

    @classmethod
    def read_attributes(cls, section: Section) -> dict[str, Any]:
        """Return the name."""
        return {"name": section.read_text("name")}

    @classmethod
    def list_set_numbers(cls, section: Section) -> Sequence[str]:
        """Return the name."""
        return (section.read_text("name"),)

    def check_scene(self, scene: Scene, where: str) -> None:
        """Refuse a pattern of names, or a value out of the number's range."""
        of = {number.name: number.number for number in scene.varied}
        if self.name not in of:
            raise Refusal(where, "name", "be one number, not a pattern", self.name, ", ".join(of))
        of[self.name].check_value(where, self.value, "value")

    def make_begin_change(self, scene: Scene) -> Change:
        """Return the value."""
        return NumberChange(self.name, self.value)

    def make_end_change(self) -> Change:
        """Return the value before."""
        return NumberChange(self.name, None)
