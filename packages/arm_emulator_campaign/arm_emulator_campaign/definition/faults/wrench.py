"""Something acts on a link: it pushes, or hits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from arm_emulator.extension.base import FORCE, MOMENT, POINT, Number, Section, number
from arm_emulator.extension.machine import (
    NO_WRENCH,
    WRENCH_AXES,
    Change,
    ExternalWrench,
    Scene,
    WrenchChange,
    move_to_moving_link,
)
from arm_emulator_campaign.definition.fault import Fault, register_fault
from arm_emulator_campaign.definition.scenario import count_all_ticks


@dataclass(frozen=True, kw_only=True)
class OnLink(Fault):
    """Base of faults that act on a link.

    Attributes:
        link: of the URDF, one that moves.
        point: in the link's frame [m].
        axes: those of the link's frame, or of the world.
    """

    link: str
    point: tuple[float, ...] = NO_WRENCH
    axes: str = "world"

    @classmethod
    def read_attributes(cls, section: Section) -> dict[str, Any]:
        """Return link, vectors and axes."""
        vectors = {
            name: section.read_vector(bound.rename(name)) or NO_WRENCH
            for name, bound in cls.vectors.items()
        }
        axes = section.read_choice("axes", WRENCH_AXES, default="world")
        return {"link": section.read_text("link"), "axes": axes, **vectors}

    @classmethod
    def list_needed_keys(cls, scene: Mapping[str, Any]) -> dict[str, Any]:
        """Return that wrenches may act."""
        return {"external_wrench": True}

    def make_wrench(self, period: float) -> ExternalWrench:
        """Return what acts, by the servo period [s]."""
        raise NotImplementedError

    def check_scene(self, scene: Scene, where: str) -> None:
        """Refuse a link that does not move."""
        move_to_moving_link(scene, where, self.link, self.make_wrench(scene.servo_period))

    def make_begin_change(self, scene: Scene) -> Change:
        """Return what acts."""
        return WrenchChange(self.link, self.make_wrench(scene.servo_period))

    def make_end_change(self) -> Change:
        """Return that nothing acts."""
        return WrenchChange(self.link, ExternalWrench())


@register_fault
@dataclass(frozen=True, kw_only=True)
class Wrench(OnLink):
    """A force and a moment act on a link.

    Attributes:
        force: [N].
        moment: about the point [N m].
    """

    kind: ClassVar[str] = "wrench"
    vectors: ClassVar[Mapping[str, Number]] = {"force": FORCE, "moment": MOMENT, "point": POINT}

    force: tuple[float, ...] = NO_WRENCH
    moment: tuple[float, ...] = NO_WRENCH

    def make_wrench(self, period: float) -> ExternalWrench:
        """Return force and moment."""
        force, moment = _stack_vector(self.force), _stack_vector(self.moment)
        return ExternalWrench(force, moment, _stack_vector(self.point), self.axes)


@register_fault
@dataclass(frozen=True, kw_only=True)
class Impulse(OnLink):
    """Something hits a link: a force acts for the time of contact, whole servo periods.

    Attributes:
        impulse: force times time [N s].
    """

    kind: ClassVar[str] = "impulse"
    vectors: ClassVar[Mapping[str, Number]] = {
        "impulse": Number("impulse", "N s", at_least=-1e4, at_most=1e4), "point": POINT
    }  # fmt: skip

    lasting: float = number("s", above=0.0, at_most=1.0, default=1e-9, text="contact")
    impulse: tuple[float, ...]

    def make_wrench(self, period: float) -> ExternalWrench:
        """Return the force."""
        contact = period * np.maximum(1, count_all_ticks(self.lasting, period))
        force = tuple(component / contact for component in self.impulse)
        return ExternalWrench(_stack_vector(force), NO_WRENCH, _stack_vector(self.point), self.axes)


def _stack_vector(vector: tuple[Any, ...]) -> Any:
    """Return a vector, of many runs a row for each (K, 3)."""
    if not any(isinstance(component, np.ndarray) for component in vector):
        return vector
    return np.stack(np.broadcast_arrays(*vector), axis=-1)
