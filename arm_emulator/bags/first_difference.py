"""The first tick, quantity and bit in which two recorded runs differ, or a run and its repeat."""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from arm_emulator.bags.recorded_machine import RecordedMachine, applied_names, applied_rows
from arm_emulator.bags.recorded_ticks import (
    Change,
    RecordedTick,
    Values,
    count_runs,
    recorded_ticks,
)
from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.bags.repetition import KINDS
from arm_emulator.base.count import check_count
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.build_facts import build_facts
from arm_emulator.machine.diverged import Diverged
from arm_emulator.machine.measured_fields import MeasuredFields
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.plant_state import SET
from arm_emulator.machine.scene import Scene, load_scene
from arm_emulator.machine.session import Session
from arm_emulator.ros.bag import Bag
from arm_emulator_msgs.msg import MotorState


@dataclass(frozen=True)
class FirstDifference:
    """The place at which two runs part.

    Attributes:
        tick: the first one that differs.
        kind: "command", "change by hand", "power", "state" (of the machine, or of what it
            measures) or "end" (one record ends before).
        quantity: by its name in messages.
        owner: joint, or another owner; empty: the machine.
        values: on both sides.
        ulps: how many representable numbers lie between two numbers; None: none are compared.
        inputs: the step that leads there, for both sides: names of rows, rows (N,).
    """

    tick: int
    kind: str
    quantity: str
    owner: str
    values: tuple[Any, Any]
    ulps: int | None
    inputs: tuple[dict[str, Values], dict[str, Values]]


@dataclass(frozen=True)
class Side:
    """One of two runs: a record, or the machine that is driven again by one."""

    topics: RecordedTopics
    scene: Scene
    run: int
    again: bool = False

    @classmethod
    def of(cls, path: Path, scene: str | None, run: int, again: bool = False) -> Side:
        """Return a run of a bag.

        Raises:
            Refusal: no such bag, scene or run.
        """
        topics = RecordedTopics(Bag(path))
        runs = count_runs(topics)
        if runs == 0:
            rule = "hold a run from tick 0 on"
            raise Refusal(str(path), "the bag", rule, "none", "record, then call emulator/reset")
        number = runs if run == -1 else check_count(str(path), "run", run, 1, runs)
        return cls(topics, load_scene(scene or topics.scene), number, again)

    def ticks(self) -> Iterator[RecordedTick]:
        """Yield its ticks, see `recorded_ticks`."""
        joints = self.scene.joint_names
        recorded = (one for one in recorded_ticks(self.topics, joints) if one.run == self.run)
        return _computed(self, recorded) if self.again else recorded

    @property
    def build(self) -> dict[str, str]:
        """Facts of the build that has computed it, as far as they are recorded."""
        return build_facts(Plant(self.scene)) if self.again else self.topics.build

    def machine(self) -> RecordedMachine:
        """Return the machine of the run, at tick 0."""
        return RecordedMachine(self.topics, self.scene, self.run)


def first_difference(one: Side, other: Side) -> tuple[FirstDifference | None, int]:
    """Return the first difference of two runs, and the number of ticks that are equal.

    Quantities that only one of the two has recorded are not compared.

    Raises:
        Refusal: other joints, or a message cannot be read.
    """
    last = count = 0
    for a, b in itertools.zip_longest(one.ticks(), other.ticks()):
        if a is None or b is None:
            ended = a is None, b is None
            return FirstDifference(last, "end", "record", "", ended, None, ({}, {})), count
        found = (
            _of_changes(one, a.before, b.before)
            or _of_values(one.scene, a, b)
            or _of_changes(one, a.changes, b.changes)
        )
        if found is not None:
            # Commands are reported at the end of the period in which they held.
            reported = found.kind in ("command", "power")
            tick = a.tick - reported
            if found.kind == "state":
                tick, found = _inside(one, other, tick) or (tick, found)
            left = tick - (found.kind == "state")
            inputs = _step(one, left), _step(other, left)
            return FirstDifference(tick, *found, inputs=inputs), count
        last = a.tick
        count += 1
    return None, count


def _inside(one: Side, other: Side, tick: int) -> tuple[int, _Found] | None:
    """Return the first difference of the two machines' true states up to a tick, driven again.

    Records hold counts of motors, and the true state of some ticks only.
    """
    a, b = one.machine(), other.machine()
    try:
        while a.tick <= tick:
            for name in SET:
                rows = getattr(a.session.state, name), getattr(b.session.state, name)
                differs = _first(*rows)
                if differs is not None:
                    place, values = differs
                    owner = one.scene.joint_names[place]
                    return a.tick, _Found("state", name, owner, values, _ulps(*values))
            a.advance(1)
            b.advance(1)
    except (Diverged, Refusal):  # the end of a record
        pass
    return None


class _Found(NamedTuple):
    """The first part of `FirstDifference`, after the tick."""

    kind: str
    quantity: str
    owner: str
    values: tuple[Any, Any]
    ulps: int | None


def _of_changes(side: Side, one: list[Change], other: list[Change]) -> _Found | None:
    kind = "change by hand"
    for a, b in zip(one, other, strict=False):
        if a.kind != b.kind:
            return _Found(kind, "kind", "", (KINDS.get(a.kind), KINDS.get(b.kind)), None)
        if a.saved != b.saved:
            return _Found(kind, *_of_machines(side.scene, a.saved, b.saved))
    if len(one) != len(other):
        kinds = [[str(KINDS.get(change.kind)) for change in side] for side in (one, other)]
        texts = (", ".join(kinds[0]) or "none", ", ".join(kinds[1]) or "none")
        return _Found(kind, "changes", "", texts, None)
    return None


def _of_machines(scene: Scene, saved: bytes, other: bytes) -> tuple[Any, ...]:
    """Return quantity, owner, values and ulps of the first difference of two saved machines."""
    machines = Plant(scene), Plant(scene)
    for plant, one in zip(machines, (saved, other), strict=True):
        plant.restore(one)
    a, b = machines
    if a.powered != b.powered:
        return "powered", "", (a.powered, b.powered), None
    for name, value in a.parameters.items():
        if _bits(value) != _bits(b.parameters[name]):
            return name, "", (value, b.parameters[name]), _ulps(value, b.parameters[name])
    for link, wrench in a.external_wrenches.items():
        if wrench != b.external_wrenches[link]:
            return "external wrench", link, (wrench, b.external_wrenches[link]), None
    for name in SET:
        found = _first(getattr(a.state, name), getattr(b.state, name))
        if found is not None:
            place, values = found
            return name, scene.joint_names[place], values, _ulps(*values)
    for name in a.measured.__slots__ if hasattr(a.measured, "__slots__") else vars(a.measured):
        rows = np.atleast_1d(getattr(a.measured, name)), np.atleast_1d(getattr(b.measured, name))
        found = _first(rows[0].ravel(), rows[1].ravel())
        if found is not None:
            return name, _owner(scene, found[0], rows[0].size), found[1], _ulps(*found[1])
    words = np.frombuffer(saved, np.uint64), np.frombuffer(other, np.uint64)
    place = int(np.argmax(words[0] != words[1])) if len(words[0]) == len(words[1]) else -1
    values = struct.unpack("<dd", saved[8 * place :][:8] + other[8 * place :][:8])
    return f"number {place} of the saved machine", "", values, _ulps(*values)


def _of_values(scene: Scene, a: RecordedTick, b: RecordedTick) -> _Found | None:
    for name in a.values:
        if name not in b.values:
            continue
        if a.values[name].tobytes() == b.values[name].tobytes():
            continue
        if len(a.values[name]) != len(b.values[name]):
            lengths = len(a.values[name]), len(b.values[name])
            return _Found("state", f"number of values of {name}", "", lengths, None)
        found = _first(a.values[name], b.values[name])
        if found is not None:
            place, values = found
            owner = _owner(scene, place, len(a.values[name]))
            kind = {"powered": "power", "applied": "command"}.get(name, "state")
            return _Found(kind, name, owner, values, _ulps(*values))
    return None


def _owner(scene: Scene, place: int, count: int) -> str:
    if count == len(scene.joint_names):
        return scene.joint_names[place]
    return scene.imus[place // 3].name if scene.imus and count == 3 * len(scene.imus) else ""


def _first(a: Values, b: Values) -> tuple[int, tuple[Any, Any]] | None:
    """Return the first place that differs, by bits, and its values."""
    # Of the bits: 0.0 and -0.0 differ, and a NaN is equal to itself.
    for place, (one, other) in enumerate(zip(a, b.astype(a.dtype), strict=True)):
        if one.tobytes() != other.tobytes():
            return place, (one.item(), other.item())
    return None


def _bits(value: float) -> bytes:
    return struct.pack("<d", value)


def _ulps(a: Any, b: Any) -> int | None:
    """Return the number of representable numbers between two floating-point numbers."""
    if not isinstance(a, float) or not isinstance(b, float) or math.isnan(a) or math.isnan(b):
        return None
    places = list[int]()
    for one in (a, b):
        (bits,) = struct.unpack("<q", _bits(one))
        places.append(bits if bits >= 0 else -(bits & 0x7FFFFFFFFFFFFFFF))
    return abs(places[0] - places[1])


def _computed(side: Side, recorded: Iterable[RecordedTick]) -> Iterator[RecordedTick]:
    """Yield the same ticks with the values that the machine, driven again, has."""
    session = Session(side.scene, "lockstep", "first_answer")
    absent = MeasuredFields(side.scene, MotorState.get_fields_and_field_types()).absent
    names, powered = applied_names(side.scene), True
    for one in recorded:
        if one.tick != session.tick:
            session.powered = powered = bool(one.values["powered"][0])
            session.advance_under(applied_rows(names, one), came=True)
            if session.fault is not None:
                return
        else:
            powered = bool(one.values["powered"][0])
            _repeat(session, one.before)
        measured, state = session.measured, session.state
        truth = {"position": state.q, "velocity": state.v, "effort": state.gear_torque}
        values: dict[str, Values] = {}
        for name, row in one.values.items():
            if name == "powered":
                values[name] = np.array([powered])
            elif name.startswith("true "):
                values[name] = truth[name.removeprefix("true ")]
            elif name in absent:
                values[name] = row[:0]
            elif hasattr(measured, name):
                values[name] = np.asarray(getattr(measured, name)).ravel().astype(row.dtype)
        yield one._replace(values=values)
        _repeat(session, one.changes)


def _repeat(session: Session, changes: list[Change]) -> None:
    """Set the machine to its state after changes by hand."""
    if changes:
        session.restore(changes[-1].saved)


def _step(side: Side, tick: int) -> dict[str, NDArray[Any]]:
    """Return the inputs of the step that leaves a tick."""
    if tick < 0:
        return {}
    machine = side.machine()
    try:
        machine.advance(min(tick, machine.last))
    except (Diverged, Refusal):
        return {}
    state = machine.session.state
    rows: dict[str, NDArray[Any]] = {name: getattr(state, name) for name in SET}
    if machine.tick < machine.last:
        rows["command"] = machine.ticks[machine.tick + 1].applied[0]
    return rows
