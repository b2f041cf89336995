"""Something pushes against a link."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from arm_emulator.base.bound import FORCE, MOMENT, POINT
from arm_emulator.base.number import Number
from arm_emulator.base.section import Section
from arm_emulator.campaign.fault import Fault
from arm_emulator.campaign.faults.registry import register_fault
from arm_emulator.machine.change import Change, WrenchChange
from arm_emulator.machine.external_wrench import AXES, NONE, ExternalWrench, on_moving_link
from arm_emulator.machine.scene import Scene


@register_fault
@dataclass(frozen=True, kw_only=True)
class Wrench(Fault):
    """A force and a moment act on a link.

    Attributes:
        link: of the URDF, one that moves.
        force: [N].
        moment: about the point [N m].
        point: in the link's frame [m].
        axes: those of the link's frame, or of the world.
    """

    kind: ClassVar[str] = "wrench"
    vectors: ClassVar[Mapping[str, Number]] = {"force": FORCE, "moment": MOMENT, "point": POINT}

    link: str
    force: tuple[float, ...] = NONE
    moment: tuple[float, ...] = NONE
    point: tuple[float, ...] = NONE
    axes: str = "world"

    @classmethod
    def others(cls, section: Section) -> dict[str, Any]:
        """Return link, vectors and axes."""
        vectors = {
            name: section.vector(bound.named(name)) or NONE for name, bound in cls.vectors.items()
        }
        axes = section.choice("axes", AXES, default="world")
        return {"link": section.text("link"), "axes": axes, **vectors}

    @classmethod
    def needs(cls, scene: Mapping[str, Any]) -> dict[str, Any]:
        """Return that wrenches may act."""
        return {"external_wrench": True}

    @property
    def _wrench(self) -> ExternalWrench:
        return ExternalWrench(self.force, self.moment, self.point, self.axes)

    def check(self, scene: Scene, where: str) -> None:
        """Refuse a link that does not move."""
        on_moving_link(scene, where, self.link, self._wrench)

    def begins(self, scene: Scene) -> Change:
        """Return force and moment."""
        return WrenchChange(self.link, self._wrench)

    def ends(self) -> Change:
        """Return that nothing acts."""
        return WrenchChange(self.link, ExternalWrench())
