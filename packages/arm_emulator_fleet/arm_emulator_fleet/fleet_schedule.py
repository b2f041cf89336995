"""Schedule of a fleet's arms in addition to their control: changes at ticks, observations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from arm_emulator.extension.base import NonCopyable, Refusal, check_count, coerce_flag, coerce_kind
from arm_emulator.extension.compiler import C_NULL as NULL
from arm_emulator.extension.compiler import CData
from arm_emulator.extension.machine import ARM_HEADER as ARM
from arm_emulator.extension.machine import WRENCH_AXES as AXES
from arm_emulator.extension.machine import (
    Change,
    ExternalWrench,
    NumberChange,
    PowerChange,
    Scene,
    WrenchChange,
    find_varied,
    move_to_moving_link,
)
from arm_emulator_fleet.fleet_machines import LARGEST_FLEET
from arm_emulator_fleet.unit import FLEET

KINDS = {
    kind: FLEET.get_constant(f"ARM_CHANGES_{name}")
    for kind, name in (
        (NumberChange, "PARAMETER"), (WrenchChange, "WRENCH"), (PowerChange, "POWER")
    )
}  # fmt: skip
Timed = tuple[int, Change]


class FleetWay(NonCopyable):
    """Changes of arms at their ticks, and a function in C that is called after each period.

    Attributes:
        struct: as `arm_fleet_way` of core/arm_fleet.h, without the links' positions.
        looks: whether there is a function.
        look_name: its name on a device; None: a pointer, or no function.

    Args:
        scene: of the arms.
        count: of arms.
        look: pointer to the function, or for arms on a device its name there (ARM_ADDRESS of
            core/kernel.hpp, see `Fleet`); None: nobody looks.
        with_: pointer that it gets, of the device for arms there; None: null. Both must outlive
            this.
    """

    instead = "a new one with the same changes"

    def __init__(
        self, scene: Scene, count: int, look: CData | str | None = None, with_: CData | None = None
    ) -> None:
        scene = coerce_kind(scene, Scene, "FleetWay", "scene", "be a Scene")
        count = check_count("FleetWay", "count", count, 1, LARGEST_FLEET)
        self.of = scene, count
        self._places = {number.name: place for place, number in enumerate(scene.varied)}
        self.struct = FLEET.make_struct("arm_fleet_way")
        self.looks, self.look_name = look is not None, look if isinstance(look, str) else None
        if look is not None:
            pointer = {} if isinstance(look, str) else {"look": look}
            FLEET.fill_struct(self.struct, **pointer, **{"with": NULL if with_ is None else with_})
        self.set_changes([()] * count)

    def __repr__(self) -> str:
        return f"<FleetWay of {self.of[1]} {self.of[0].name}>"

    def set_changes(self, changes: Sequence[Sequence[Timed]]) -> None:
        """Let changes happen from now on, instead of those before.

        Args:
            changes: of each arm: ticks since its reset before which they happen, ascending, and
                what is set.

        Raises:
            Refusal: not a list for each arm, ticks that do not ascend, or a change that the scene
                does not take; nothing has changed.
        """
        where, (scene, count) = "FleetWay", self.of
        if not isinstance(changes, Sequence) or len(changes) != count:
            raise Refusal(where, "changes", f"be a list for each of {count} arms", changes)
        first = [0]
        rows: list[tuple[int, int, int, float]] = []
        wrenches: list[tuple[int, int, ExternalWrench]] = []
        for of_arm in changes:
            before = 0
            for tick, change in of_arm:
                tick = check_count(where, "tick", tick, -(2**63))
                if not before <= tick:
                    raise Refusal(where, "ticks", "ascend from 0", tick)
                before = tick
                kind, place, value = KINDS[PowerChange], 0, 0.0
                if isinstance(change, NumberChange):
                    varied = find_varied(scene.varied, change.name, where)
                    kind, place = KINDS[NumberChange], self._places[change.name]
                    value = varied.number.check_value(where, change.value)
                elif isinstance(change, WrenchChange):
                    kind = KINDS[WrenchChange]
                    place, moved = move_to_moving_link(scene, where, change.link, change.wrench)
                    wrenches.append((len(rows), AXES.index(moved.axes), moved))
                elif isinstance(change, PowerChange):
                    value = float(coerce_flag(change.on, where, "power"))
                else:
                    rule = "be a NumberChange, WrenchChange or PowerChange"
                    raise Refusal(where, "change", rule, change)
                rows.append((tick, kind, place, value))
            first.append(len(rows))
        self._store_changes(first, rows, wrenches)

    def _store_changes(
        self,
        first: list[int],
        rows: list[tuple[int, int, int, float]],
        wrenches: list[tuple[int, int, ExternalWrench]],
    ) -> None:
        """Put the changes where the core finds them."""
        self._rows = FLEET.make_rows("arm_fleet_change", max(1, len(rows)))
        self._first = np.array(first, np.int64)
        self._wrenches = ARM.make_rows("arm_wrench", max(1, len(wrenches)))
        if rows:
            for name, column in zip(
                ("tick", "kind", "place", "value"), zip(*rows, strict=True), strict=True
            ):
                self._rows[name] = column
        if wrenches:
            at, axes, moved = zip(*wrenches, strict=True)
            of = self._wrenches
            of["size"], of["axes"] = of.itemsize, axes
            for name in ("point", "force", "moment"):
                of[name] = [getattr(change, name) for change in moved]
            began = of.__array_interface__["data"][0]
            self._rows["wrench"][list(at)] = began + of.itemsize * np.arange(len(of))
        FLEET.fill_struct(
            self.struct,
            change=FLEET.make_pointer("arm_fleet_change", self._rows),
            first_change=self._first,
        )
