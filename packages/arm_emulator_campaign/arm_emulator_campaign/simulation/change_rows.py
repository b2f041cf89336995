"""Changes of many runs as the core of a fleet has them, computed in arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import Array
from arm_emulator.extension.machine import ARM_HEADER as ARM
from arm_emulator.extension.machine import (
    WRENCH_AXES,
    Change,
    NumberChange,
    Scene,
    WrenchChange,
    find_varied,
    move_to_moving_link,
)
from arm_emulator_campaign.definition.fault import SOUND, UNCHANGED, Fault, schedule_events
from arm_emulator_fleet import FleetWay
from arm_emulator_fleet.fleet_schedule import KINDS
from arm_emulator_fleet.unit import FLEET


@dataclass(frozen=True)
class ChangeRows:
    """Changes by faults and forks of runs, of each run ascending by ticks.

    Attributes:
        first: place of the first row of each run, and the end (K + 1,).
        rows: ``arm_fleet_change`` (C + 1,), the last one for a pointer where no run has a change.
        wrenches: to which rows point.
    """

    first: NDArray[np.int64]
    rows: NDArray[Any]
    wrenches: Sequence[NDArray[Any]]

    def give_to(self, way: FleetWay, first: int, end: int) -> NDArray[np.int64]:
        """Let the changes of the runs [first, end) happen to the first arms, and none to others.

        Returns:
            What must outlive their use, as this.
        """
        of_arms = np.full(way.of[1] + 1, self.first[end] - self.first[first])
        of_arms[: end - first] = self.first[first:end] - self.first[first]
        rows = self.rows[self.first[first] :]
        way.struct.change = FLEET.make_pointer("arm_fleet_change", rows)
        FLEET.fill_struct(way.struct, first_change=of_arms)
        return of_arms


def make_change_rows(
    faults: Sequence[Fault],
    reseeds: Sequence[tuple[int, float]],
    scene: Scene,
    sound: Array,
) -> ChangeRows:
    """Return the changes of runs.

    Args:
        faults: of all runs, their numbers constant or arrays (K,).
        reseeds: of all runs, see `Case`.
        scene: the machine.
        sound: its varied numbers without faults (K, P).

    Raises:
        Refusal: a value that is out of its range.
    """
    count, F, R = len(sound), len(faults), len(reseeds)
    events = schedule_events(faults, scene, count)
    shape = count, R + 2 * F
    ticks = np.empty(shape, np.int64)
    ticks[:, R:] = events.ticks
    columns = _Columns(scene, sound, shape)
    for place, (tick, seed) in enumerate(reseeds):
        ticks[:, place] = tick
        columns.put_change(np.s_[:], place, NumberChange("seed", seed))
    happens = np.ones(shape, bool)
    happens[:, R:] = events.holders != UNCHANGED
    ends = [fault.make_end_change() for fault in faults]
    for event in range(2 * F):
        holders = events.holders[:, event]
        for holder in set(holders.tolist()) - {UNCHANGED}:
            change = ends[event % F] if holder == SOUND else events.changes[holder]
            runs = holders == holder
            columns.put_change(np.s_[:] if np.all(runs) else runs, R + event, change)
    order = np.argsort(ticks, axis=1, kind="stable")
    run = np.arange(count)[:, None]
    selected = happens[run, order]
    rows = FLEET.make_rows("arm_fleet_change", int(np.count_nonzero(selected)) + 1)
    rows["tick"][:-1] = ticks[run, order][selected]
    for name, column in columns.fields.items():
        rows[name][:-1] = column[run, order][selected]
    first = np.concatenate([[0], np.cumsum(np.count_nonzero(selected, axis=1))])
    return ChangeRows(first.astype(np.int64), rows, columns.wrenches)


class _Columns:
    """Fields of ``arm_fleet_change`` beside ticks, by run and event (K, E)."""

    def __init__(self, scene: Scene, sound: Array, shape: tuple[int, int]) -> None:
        self._scene, self._sound = scene, sound
        self._places = {number.name: place for place, number in enumerate(scene.varied)}
        self.fields: dict[str, NDArray[Any]] = {
            "kind": np.zeros(shape, np.int32),
            "place": np.zeros(shape, np.int32),
            "value": np.zeros(shape),
            "wrench": np.zeros(shape, np.uint64),
        }
        self.wrenches: list[NDArray[Any]] = []

    def put_change(self, runs: Any, event: int, change: Change) -> None:
        """Let a change happen at an event of some runs; a change of arrays is of all runs."""
        where, count = "campaign", len(self._sound)
        values: dict[str, Any] = {"kind": KINDS[type(change)]}
        if isinstance(change, NumberChange):
            varied = find_varied(self._scene.varied, change.name, where)
            values["place"] = place = self._places[change.name]
            value = self._sound[:, place] if change.value is None else change.value
            varied.number.check_values(where, np.atleast_1d(value))
            values["value"] = value
        elif isinstance(change, WrenchChange):
            values["place"], values["wrench"] = self._add_wrench(change)
        else:
            values["value"] = float(change.on)
        for name, value in values.items():
            self.fields[name][runs, event] = np.broadcast_to(value, count)[runs]

    def _add_wrench(self, change: WrenchChange) -> tuple[int, Any]:
        """Return the link, and the addresses of the wrench of each run, or of that of all."""
        vectors = change.wrench.force, change.wrench.moment, change.wrench.point
        sizes = {len(rows) for rows in vectors if isinstance(rows, np.ndarray)}
        link, wrench = move_to_moving_link(
            self._scene, "campaign", change.link, change.wrench, *sizes
        )
        rows = ARM.make_rows("arm_wrench", *(sizes or {1}))
        rows["size"], rows["axes"] = rows.itemsize, WRENCH_AXES.index(wrench.axes)
        for name in ("point", "force", "moment"):
            rows[name] = getattr(wrench, name)
        self.wrenches.append(rows)
        began = rows.__array_interface__["data"][0]
        return link, np.uint64(began) + np.uint64(rows.itemsize) * np.arange(
            len(rows), dtype=np.uint64
        )
