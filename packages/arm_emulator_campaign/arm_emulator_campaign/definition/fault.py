"""A fault: what goes wrong with a machine, from one tick to another.

A new kind is a file in `faults`: a frozen dataclass that declares its numbers, and how it begins
and ends. Files, refusals, docs and what can vary follow from it. Its numbers may be arrays, one of
each run (K,): a fault of many runs, which is not checked, and whose changes have arrays, too.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import (
    Array,
    Number,
    Refusal,
    Registry,
    Section,
    list_numbers,
    number,
)
from arm_emulator.extension.machine import Change, NumberChange, Scene
from arm_emulator_campaign.definition.scenario import count_all_ticks


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
    def read_section(cls, section: Section) -> Self:
        """Return the one that a section states.

        Raises:
            Refusal: a number out of its range.
        """
        return cls(**section.read_numbers(cls), **cls.read_attributes(section))

    @classmethod
    def read_attributes(cls, section: Section) -> dict[str, Any]:
        """Return what a section states beside numbers."""
        return {}

    @classmethod
    def list_set_numbers(cls, section: Section) -> Sequence[str]:
        """Return the numbers of the scene that it sets, which become data of the machine."""
        return ()

    @classmethod
    def list_needed_keys(cls, scene: Mapping[str, Any]) -> dict[str, Any]:
        """Return what a scene file that has these keys lacks for it, as `load_scene` takes it."""
        return {}

    @classmethod
    def get_unit(cls, key: str) -> str:
        """Return the unit of a number or a vector."""
        number = list_numbers(cls).get(key) or cls.vectors.get(key)
        return number.unit if number else ""

    def replace_numbers(
        self, numbers: Iterable[tuple[Sequence[str], float | Array]]
    ) -> Self | None:
        """Return it with other numbers, as if it had been read so.

        Args:
            numbers: of each its path, the name of a number, or of a vector and the place in it;
                and its value, or those of many runs (K,).

        Returns:
            None: no such number, or a value out of its range, which `read_section` refuses.
        """
        changed: dict[str, Any] = {}
        own = list_numbers(type(self))
        for (key, *place), value in numbers:
            bound = self.vectors.get(key) if place else own.get(key)
            if bound is None or not is_value_in_range(bound, value):
                return None
            if place:
                entries = list(changed.get(key) or getattr(self, key))
                entries[int(place[0])] = value
                changed[key] = tuple(entries)
            else:
                changed[key] = (
                    value if isinstance(value, np.ndarray) else bound.check_value("", value)
                )
        return replace(self, **changed)

    def check_scene(self, scene: Scene, where: str) -> None:
        """Refuse what this scene cannot have."""

    def make_begin_change(self, scene: Scene) -> Change:
        """Return what is set in the machine when it begins."""
        raise NotImplementedError

    def make_end_change(self) -> Change:
        """Return what is set when it ends."""
        raise NotImplementedError


def is_value_in_range(bound: Number, value: float | Array) -> bool:
    """Return whether a number is in its range, or all of several."""
    if not isinstance(value, np.ndarray):
        return bound.is_in_range(value)
    try:
        bound.check_values("", value)
    except Refusal:
        return False
    return True


_KINDS = Registry[Fault]("fault", f"{__package__}.faults", lambda kind: str(kind.kind))
register_fault = _KINDS.register


def list_faults() -> dict[str, type[Fault]]:
    """Return all kinds by name."""
    return dict(sorted(_KINDS.list_kinds().items()))


UNCHANGED, SOUND = -2, -1  # in the place of a fault


@dataclass(frozen=True)
class Events:
    """Ends of the F faults of runs, and behind them their begins.

    Attributes:
        changes: what each fault sets.
        ticks: before which they happen (K, 2 F).
        holders: the fault that sets the same quantity from then on (K, 2 F); SOUND: none;
            UNCHANGED: the same one as before, which is newer than one that ends.
    """

    changes: Sequence[Change]
    ticks: NDArray[np.int64]
    holders: NDArray[np.int64]


def schedule_events(faults: Sequence[Fault], scene: Scene, count: int) -> Events:
    """Return the events of the faults of so many runs.

    Of faults that set the same (a number, the wrench on a link, the power), the newest holds; when
    it ends, the newest of those that still last holds again.
    """
    period, F = scene.servo_period, len(faults)
    changes = [fault.make_begin_change(scene) for fault in faults]
    ticks = np.empty((count, 2 * F), np.int64)
    for place, fault in enumerate(faults):
        ticks[:, F + place] = begins = count_all_ticks(fault.at, period)
        ticks[:, place] = begins + np.maximum(1, count_all_ticks(fault.lasting, period))
    holders = np.empty_like(ticks)
    places_by_quantity: dict[str, list[int]] = {}
    for place, change in enumerate(changes):
        places_by_quantity.setdefault(change.quantity, []).append(place)
    for places in places_by_quantity.values():
        columns = np.array([*places, *(F + place for place in places)])
        order = columns[np.argsort(ticks[:, columns], axis=1, kind="stable")]
        orders, which = order[:1], np.zeros(count, np.int64)
        if np.any(order != orders):
            orders, which = np.unique(order, axis=0, return_inverse=True)
        holders_by_order = np.array([_find_holders(events, F) for events in orders.tolist()])
        holders[:, columns] = holders_by_order[which.reshape(-1)][:, columns]
    return Events(changes, ticks, holders)


def _find_holders(events: Sequence[int], F: int) -> list[int]:
    """Return the holder after each event of faults that set the same, at its place of 2 F."""
    holders, active = [UNCHANGED] * (2 * F), list[int]()
    for event in events:
        fault = event % F
        if event >= F:
            active.append(fault)
        else:
            place = active.index(fault)
            del active[place]
            if place < len(active):
                continue  # a newer one holds
        holders[event] = active[-1] if active else SOUND
    return holders


def schedule_changes(
    faults: Iterable[Fault], scene: Scene, values: Mapping[str, float]
) -> list[tuple[int, Change]]:
    """Return what faults of a run set, with the ticks before which that happens, ascending.

    Args:
        faults: of a run, see `schedule_events`.
        scene: the machine.
        values: of its varied numbers, where they are not those of the scene.
    """
    sound = {number.name: number.value for number in scene.varied} | dict(values)
    of_run = list(faults)
    events = schedule_events(of_run, scene, 1)
    changes: list[tuple[int, Change]] = []
    for event in np.argsort(events.ticks[0], kind="stable"):
        holder = events.holders[0, event]
        if holder == UNCHANGED:
            continue
        ended = of_run[event % len(of_run)]
        change = ended.make_end_change() if holder == SOUND else events.changes[holder]
        if isinstance(change, NumberChange) and change.value is None:
            change = replace(change, value=sound[change.name])
        changes.append((int(events.ticks[0, event]), change))
    return changes
