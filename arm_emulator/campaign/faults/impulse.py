"""Something hits a link."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from arm_emulator.base.bound import POINT
from arm_emulator.base.number import Number, number
from arm_emulator.base.section import Section
from arm_emulator.campaign.fault import Fault
from arm_emulator.campaign.faults.registry import register_fault
from arm_emulator.campaign.scenario import ticks_of
from arm_emulator.machine.change import Change, WrenchChange
from arm_emulator.machine.external_wrench import AXES, NONE, ExternalWrench, on_moving_link
from arm_emulator.machine.scene import Scene

_IMPULSE = Number("impulse", "N s", at_least=-1e4, at_most=1e4)


@register_fault
@dataclass(frozen=True, kw_only=True)
class Impulse(Fault):
    """Something hits a link: a force acts for the time of contact, whole servo periods.

    Attributes:
        link: of the URDF, one that moves.
        impulse: force times time [N s].
        point: in the link's frame [m].
        axes: those of the link's frame, or of the world.
    """

    kind: ClassVar[str] = "impulse"
    vectors: ClassVar[Mapping[str, Number]] = {"impulse": _IMPULSE, "point": POINT}

    lasting: float = number("s", above=0.0, at_most=1.0, default=1e-9, text="contact")
    link: str
    impulse: tuple[float, ...]
    point: tuple[float, ...] = NONE
    axes: str = "world"

    @classmethod
    def others(cls, section: Section) -> dict[str, Any]:
        """Return link, vectors and axes."""
        return {
            "link": section.text("link"),
            "impulse": section.vector(_IMPULSE),
            "point": section.vector(POINT) or NONE,
            "axes": section.choice("axes", AXES, default="world"),
        }

    @classmethod
    def needs(cls, scene: Mapping[str, Any]) -> dict[str, Any]:
        """Return that wrenches may act."""
        return {"external_wrench": True}

    def _wrench(self, period: float) -> ExternalWrench:
        contact = period * max(1, ticks_of(self.lasting, period))
        force = tuple(one / contact for one in self.impulse)
        return ExternalWrench(force, NONE, self.point, self.axes)

    def check(self, scene: Scene, where: str) -> None:
        """Refuse a link that does not move."""
        on_moving_link(scene, where, self.link, self._wrench(scene.servo_period))

    def begins(self, scene: Scene) -> Change:
        """Return the force."""
        return WrenchChange(self.link, self._wrench(scene.servo_period))

    def ends(self) -> Change:
        """Return that nothing acts."""
        return WrenchChange(self.link, ExternalWrench())
