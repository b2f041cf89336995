"""The first tick, quantity and bit in which two recorded runs differ."""

import contextlib
import itertools
import math
from typing import Any, NamedTuple

import numpy as np

from arm_emulator.extension.bags import (
    EVENT_KINDS,
    RecordedChange,
    RecordedMachine,
    RecordedTick,
    find_first_difference_of_bits,
)
from arm_emulator.extension.base import Refusal
from arm_emulator.extension.machine import DECIDING_STATE, Diverged, Plant, Scene


class FirstDifference(NamedTuple):
    """The place at which two runs part."""

    tick: int
    """The first one that differs."""
    kind: str
    """"command", "change by hand", "power", "state" (of the machine, or of what it measures) or
    "end" (one record ends before)."""
    quantity: str
    """By its name in messages."""
    owner: str
    """Joint, or another owner; empty: the machine."""
    values: tuple[Any, Any]
    """On both sides."""

    @property
    def ulps(self) -> int | None:
        """Representable numbers between two numbers; None: other values differ."""
        if not all(isinstance(value, float) and not math.isnan(value) for value in self.values):
            return None
        bits = np.array(self.values).view(np.int64).tolist()
        places = [bit if bit >= 0 else -(bit & 0x7FFFFFFFFFFFFFFF) for bit in bits]
        return abs(int(places[0] - places[1]))


def find_first_difference(
    first: RecordedMachine, second: RecordedMachine
) -> tuple[FirstDifference | None, int]:
    """Return the first difference of two runs, and the number of ticks that are equal.

    Quantities that only one of the two has recorded are not compared. Where records differ in the
    state, the machines, at tick 0, are driven again up to the first difference of their true
    states: records hold counts of motors, and the true state of some ticks only.

    Raises:
        Refusal: a message cannot be read.
    """
    last = count = 0
    for a, b in itertools.zip_longest(first.read_records(), second.read_records()):
        if a is None or b is None:
            return FirstDifference(last, "end", "record", "", (a is None, b is None)), count
        difference = (
            _compare_changes(first.scene, a.tick, a.before, b.before)
            or _compare_values(first.scene, a, b)
            or _compare_changes(first.scene, a.tick, a.changes, b.changes)
        )
        if difference is not None and difference.kind == "state":
            return _compare_true_states(first, second, a.tick) or difference, count
        if difference is not None:
            return difference, count
        last, count = a.tick, count + 1
    return None, count


def _compare_true_states(
    first: RecordedMachine, second: RecordedMachine, tick: int
) -> FirstDifference | None:
    with contextlib.suppress(Diverged, Refusal):  # the end of a record
        while first.tick <= tick:
            for name in DECIDING_STATE:
                place = find_first_difference_of_bits(
                    getattr(first.session.state, name), getattr(second.session.state, name)
                )
                if place is not None:
                    owner = first.scene.joint_names[place[0]]
                    return FirstDifference(first.tick, "state", name, owner, place[1])
            first.advance(1)
            second.advance(1)
    return None


def _compare_changes(
    scene: Scene, tick: int, first: list[RecordedChange], second: list[RecordedChange]
) -> FirstDifference | None:
    kinds = [[str(EVENT_KINDS.get(change.kind)) for change in side] for side in (first, second)]
    if kinds[0] != kinds[1]:
        texts = ", ".join(kinds[0]) or "none", ", ".join(kinds[1]) or "none"
        return FirstDifference(tick, "change by hand", "changes", "", texts)
    for a, b in zip(first, second, strict=True):
        if a.saved != b.saved:
            quantity, values = _compare_machines(scene, a.saved, b.saved)
            return FirstDifference(tick, "change by hand", quantity, "", values)
    return None


def _compare_machines(
    scene: Scene, saved: bytes, second_state: bytes
) -> tuple[str, tuple[Any, Any]]:
    """Return the first number or state that differs in two saved machines, and both values."""
    sides = list[dict[str, Any]]()
    for state in (saved, second_state):
        plant = Plant(scene)
        plant.restore(state)
        states = {name: getattr(plant.state, name).tolist() for name in DECIDING_STATE}
        wrenches = {f"wrench on {link}": w for link, w in plant.external_wrenches.items()}
        sides.append({"powered": plant.powered, **plant.parameters, **wrenches, **states})
    for name, value in sides[0].items():
        if value != sides[1][name]:
            return name, (value, sides[1][name])
    return "what else is saved of the machine", ("one", "another")


def _compare_values(scene: Scene, a: RecordedTick, b: RecordedTick) -> FirstDifference | None:
    for name, row in a.values.items():
        theirs = b.values.get(name, row)
        kind = {"powered": "power", "applied": "command"}.get(name, "state")
        # Commands are reported at the end of the period in which they held.
        tick = a.tick if kind == "state" else a.tick - 1
        if len(row) != len(theirs):
            lengths = len(row), len(theirs)
            return FirstDifference(tick, kind, f"number of values of {name}", "", lengths)
        place = find_first_difference_of_bits(row, theirs)
        if place is not None:
            owner = _find_owner(scene, place[0], len(row))
            return FirstDifference(tick, kind, name, owner, place[1])
    return None


def _find_owner(scene: Scene, place: int, count: int) -> str:
    if count == len(scene.joint_names):
        return scene.joint_names[place]
    return scene.imus[place // 3].name if scene.imus and count == 3 * len(scene.imus) else ""
