"""The record of each tick of a run, as arrays in one order of joints."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.outputs import KNOWN
from arm_emulator.ros.node_shell import nanoseconds_of
from arm_emulator_msgs.msg import MachineEvent, MotorState

Values = NDArray[Any]
TRUTH = ("position", "velocity", "effort")
_OF_UNITS = {name for name, one in KNOWN.items() if one.per_unit}
_NAMES = ("joint_names", "reading_names", "imu_names")
_FIELDS = MotorState.get_fields_and_field_types()
# Its arrays of numbers, commands first.
_LISTS = ["applied"] + [
    name
    for name, kind in _FIELDS.items()
    if "sequence" in kind and name not in (*_NAMES, "applied", "readings")
]


class Change(NamedTuple):
    """A change by hand, by its number in messages, and the machine after it."""

    kind: int
    saved: bytes


class RecordedTick(NamedTuple):
    """Everything that is recorded at a tick."""

    run: int
    """Number of its run in the bag, from 1 on."""
    tick: int
    stamp: int
    """Logical time [ns]."""
    published: int
    """Wall time at which it was reported [ns]."""
    before: list[Change]
    """Changes by hand before the tick was reported, at tick 0."""
    values: dict[str, Values]
    """By name, in the order in which a step leads to them; the first is `powered`."""
    changes: list[Change]
    """Changes by hand after it was reported."""


def recorded_ticks(
    topics: RecordedTopics, joints: tuple[str, ...], only: Collection[str] | None = None
) -> Iterator[RecordedTick]:
    """Yield the ticks of all runs of a bag; a run begins at tick 0.

    Args:
        topics: the bag.
        joints: the order of values.
        only: names of the values beside `powered` that are read, for speed; None: all.

    Raises:
        Refusal: other joints, or values of another number.
    """
    where, run = str(topics.bag.path), 0
    waiting: list[Change] = []
    now: RecordedTick | None = None
    wanted = ["motor_states", "emulator/events"]
    wanted += ["emulator/joint_states"] if only is None else []
    orders = _Orders(joints, where)
    for name, message, published in topics.read_in_place(*wanted):
        if name == "emulator/events":
            change = Change(int(message.kind), bytes(message.state))
            if message.kind == MachineEvent.KIND_RESET:
                waiting = [change]
            elif now is not None and message.tick == now.tick and not waiting:
                now.changes.append(change)
            elif message.tick == 0:
                waiting.append(change)
        elif name == "motor_states":
            tick = int(message.tick)
            if now is not None and tick == now.tick and not waiting:
                continue  # published again: no answer came, or it was changed by hand
            if now is not None:
                yield now
                now = None
            run += tick == 0
            if run:  # else it began before the record
                values = _arranged(message, orders, where, only)
                stamp = nanoseconds_of(message.header.stamp)
                now = RecordedTick(run, tick, stamp, published, waiting, values, [])
            waiting = []
        elif now is not None and nanoseconds_of(message.header.stamp) == now.stamp:
            order = orders.of(message.name)
            for field in TRUTH:
                row = np.array(getattr(message, field))[order]
                now.values.setdefault(f"true {field}", row)
    if now is not None:
        yield now


class _Orders:
    """Places of the scene's joints in messages, which have one order for long."""

    def __init__(self, joints: tuple[str, ...], where: str) -> None:
        self._joints, self._where = joints, where
        self._names: list[str] = []
        self._order: list[int] = []

    def of(self, names: list[str]) -> list[int]:
        """Return the places in a message with these names."""
        if names != self._names or not self._order:
            if sorted(names) != sorted(self._joints):
                known = ", ".join(self._joints)
                got = ", ".join(names)
                raise Refusal(self._where, "joints", "be those of the scene", got, known)
            self._names, self._order = names, [names.index(name) for name in self._joints]
        return self._order


def _arranged(
    state: MotorState, orders: _Orders, where: str, only: Collection[str] | None
) -> dict[str, Values]:
    order = orders.of(state.joint_names)
    values: dict[str, Values] = {"powered": np.array([state.powered])}
    for name in _LISTS:
        if only is not None and name not in only:
            continue
        row = np.array(getattr(state, name))
        values[name] = row[order] if len(row) == len(order) and name not in _OF_UNITS else row
    readings = np.array(state.readings)
    if len(readings) != len(order) * len(state.reading_names):
        raise Refusal(
            where, "readings", "have a value per name and joint", f"{len(readings)} values"
        )
    for name, row in zip(state.reading_names, readings.reshape(-1, len(order)), strict=True):
        if only is None or name in only:
            values[str(name)] = row[order]
    return values
