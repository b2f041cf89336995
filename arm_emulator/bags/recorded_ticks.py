"""The record of each tick of a run, as arrays in one order of joints."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.outputs import KNOWN
from arm_emulator.ros.node_shell import nanoseconds_of
from arm_emulator_msgs.msg import MachineEvent, MotorState

Values = NDArray[Any]
TRUTH = ("position", "velocity", "effort")
_OF_UNITS = {name for name, one in KNOWN.items() if one.per_unit}
_NAMES = ("joint_names", "reading_names", "imu_names")


class Change(NamedTuple):
    """A change by hand, by its number in messages, and the machine after it."""

    kind: int
    saved: bytes


class RecordedTick(NamedTuple):
    """Everything that is recorded at a tick."""

    run: int
    """Number of its run in the bag, from 1 on."""
    tick: int
    published: int
    """Wall time at which it was reported [ns]."""
    before: list[Change]
    """Changes by hand before the tick was reported, at tick 0."""
    values: dict[str, Values]
    """By name, in the order in which a step leads to them; the first is `powered`."""
    changes: list[Change]
    """Changes by hand after it was reported."""


def recorded_ticks(topics: RecordedTopics, joints: tuple[str, ...]) -> Iterator[RecordedTick]:
    """Yield the ticks of all runs of a bag; a run begins at tick 0.

    Args:
        topics: the bag.
        joints: the order of values.

    Raises:
        Refusal: other joints, or values of another number.
    """
    where, run, stamp = str(topics.bag.path), 0, -1
    waiting: list[Change] = []
    now: RecordedTick | None = None
    wanted = ("motor_states", "emulator/joint_states", "emulator/events")
    for name, message, published in topics.read_with_time(*wanted):
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
                values = _arranged(message, joints, where)
                now = RecordedTick(run, tick, published, waiting, values, [])
            waiting, stamp = [], nanoseconds_of(message.header.stamp)
        elif now is not None and nanoseconds_of(message.header.stamp) == stamp:
            order = _order(message.name, joints, where)
            for field in TRUTH:
                row = np.array(getattr(message, field))[order]
                now.values.setdefault(f"true {field}", row)
    if now is not None:
        yield now


def count_runs(topics: RecordedTopics) -> int:
    """Return how many runs begin in a bag."""
    runs, before = 0, -1
    for _, state in topics.read("motor_states"):
        runs += state.tick == 0 and before != 0
        before = state.tick
    return runs


def _order(names: list[str], joints: tuple[str, ...], where: str) -> list[int]:
    if sorted(names) != sorted(joints):
        raise Refusal(where, "joints", "be those of the scene", ", ".join(names), ", ".join(joints))
    return [list(names).index(name) for name in joints]


def _arranged(state: MotorState, joints: tuple[str, ...], where: str) -> dict[str, Values]:
    order = _order(state.joint_names, joints, where)
    values: dict[str, Values] = {"powered": np.array([state.powered])}
    fields = state.get_fields_and_field_types()
    lists = [name for name, kind in fields.items() if "sequence" in kind and name not in _NAMES]
    for name in ("applied", *(one for one in lists if one not in ("applied", "readings"))):
        row = np.array(getattr(state, name))
        values[name] = row[order] if len(row) == len(order) and name not in _OF_UNITS else row
    readings = np.array(state.readings)
    if len(readings) != len(order) * len(state.reading_names):
        raise Refusal(
            where, "readings", "have a value per name and joint", f"{len(readings)} values"
        )
    for name, row in zip(state.reading_names, readings.reshape(-1, len(order)), strict=True):
        values[str(name)] = row[order]
    return values
