"""A fault: what goes wrong with a machine, from one tick to another.

A new kind is a file in `faults`: a frozen dataclass that declares its numbers, and how it begins
and ends. Files, refusals, docs and what can vary follow from it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

from arm_emulator.extension.base import Number, Registry, Section, list_numbers, number
from arm_emulator.extension.machine import Change, NumberChange, Scene
from arm_emulator_campaign.definition.scenario import count_ticks


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Base of all faults.

    Attributes:
        kind: its name in files.
        vectors: bounds of its attributes that are vectors.
    """

    kind: ClassVar[str] = ""
    vectors: ClassVar[Mapping[str, Number]] = {}

    at: float = number("s", at_least=0.0, text="when it begins")
    lasting: float = number("s", above=0.0, default=math.inf, text="how long; to the end if absent")

    @classmethod
    def read(cls, section: Section) -> Self:
        """Return the one that a section states.

        Raises:
            Refusal: a number out of its range.
        """
        return cls(**section.numbers(cls), **cls.others(section))

    @classmethod
    def others(cls, section: Section) -> dict[str, Any]:
        """Return what a section states beside numbers."""
        return {}

    @classmethod
    def sets(cls, section: Section) -> Sequence[str]:
        """Return the numbers of the scene that it sets, which become data of the machine."""
        return ()

    @classmethod
    def needs(cls, scene: Mapping[str, Any]) -> dict[str, Any]:
        """Return what a scene file that has these keys lacks for it, as `load_scene` takes it."""
        return {}

    @classmethod
    def unit_of(cls, key: str) -> str:
        """Return the unit of a number or a vector."""
        number = list_numbers(cls).get(key) or cls.vectors.get(key)
        return number.unit if number else ""

    def with_numbers(self, numbers: Iterable[tuple[Sequence[str], float]]) -> Self | None:
        """Return it with other numbers, as if it had been read so.

        Args:
            numbers: of each its path, the name of a number, or of a vector and the place in it;
                and its value.

        Returns:
            None: no such number, or a value out of its range, which `read` refuses.
        """
        changed: dict[str, Any] = {}
        own = list_numbers(type(self))
        for (key, *place), value in numbers:
            bound = self.vectors.get(key) if place else own.get(key)
            if bound is None or not bound.is_in_range(value):
                return None
            if place:
                entries = list(changed.get(key) or getattr(self, key))
                entries[int(place[0])] = value
                changed[key] = tuple(entries)
            else:
                changed[key] = bound.take("", value)
        return replace(self, **changed)

    def check(self, scene: Scene, where: str) -> None:
        """Refuse what this scene cannot have."""

    def begins(self, scene: Scene) -> Change:
        """Return what is set in the machine when it begins."""
        raise NotImplementedError

    def ends(self) -> Change:
        """Return what is set when it ends."""
        raise NotImplementedError


_KINDS = Registry[Fault]("fault", f"{__package__}.faults", lambda kind: str(kind.kind))
register_fault = _KINDS.register


def list_faults() -> dict[str, type[Fault]]:
    """Return all kinds by name."""
    return dict(sorted(_KINDS.kinds().items()))


def schedule_changes(
    faults: Iterable[Fault], scene: Scene, values: Mapping[str, float]
) -> list[tuple[int, Change]]:
    """Return what faults set in a machine, with the ticks before which that happens, ascending.

    Of faults that set the same (a number, the wrench on a link, the power), the newest holds; when
    it ends, the newest of those that still last holds again.

    Args:
        faults: of a run.
        scene: the machine.
        values: of its varied numbers, where they are not those of the scene.
    """
    period = scene.servo_period
    sound = {number.name: number.value for number in scene.varied} | dict(values)
    begun: list[tuple[int, Fault, bool]] = []
    ended: list[tuple[int, Fault, bool]] = []
    for fault in faults:
        begins = count_ticks(fault.at, period)
        begun.append((begins, fault, True))
        ended.append((begins + max(1, count_ticks(fault.lasting, period)), fault, False))
    active_by_quantity: dict[str, list[tuple[Fault, Change]]] = {}
    changes: list[tuple[int, Change]] = []
    for tick, fault, begins_now in sorted(ended + begun, key=lambda event: event[0]):
        change = fault.begins(scene)
        same = active_by_quantity.setdefault(change.quantity, [])
        if begins_now:
            same.append((fault, change))
        else:
            place = next(place for place, pair in enumerate(same) if pair[0] is fault)
            del same[place]
            if place < len(same):
                continue  # a newer one holds
            change = same[-1][1] if same else fault.ends()
            if isinstance(change, NumberChange) and change.value is None:
                change = replace(change, value=sound[change.name])
        changes.append((tick, change))
    return changes
