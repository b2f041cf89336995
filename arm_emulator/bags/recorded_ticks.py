"""The record of each tick of a run, as arrays in one order of joints."""

from collections.abc import Collection, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import JointState

from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.outputs import KNOWN
from arm_emulator.ros.messages.time_stamp import convert_to_nanoseconds
from arm_emulator_msgs.msg import MachineEvent, MotorState

Values = NDArray[Any]
TRUTH = ("position", "velocity", "effort")
_OF_UNITS = {name for name, output in KNOWN.items() if output.per_unit}
_NAMES = ("joint_names", "reading_names", "imu_names")
_FIELDS = MotorState.get_fields_and_field_types()
# Its arrays of numbers, commands first.
_LISTS = ["applied"] + [
    name
    for name, kind in _FIELDS.items()
    if "sequence" in kind and name not in (*_NAMES, "applied", "readings")
]


class RecordedChange(NamedTuple):
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
    before: list[RecordedChange]
    """Changes by hand before the tick was reported, at tick 0."""
    values: dict[str, Values]
    """By name, in the order in which a step leads to them; the first is `powered`."""
    changes: list[RecordedChange]
    """Changes by hand after it was reported."""


def read_ticks(
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
    waiting: list[RecordedChange] = []
    now: RecordedTick | None = None
    topics_read = ["motor_states", "emulator/events"]
    topics_read += ["emulator/joint_states"] if only is None else []
    places = JointPlaces(joints, where)
    for name, message, published in topics.read_in_place(*topics_read):
        if name == "emulator/events":
            change = RecordedChange(int(message.kind), bytes(message.state))
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
                values = arrange_state(message, places, only)
                stamp = convert_to_nanoseconds(message.header.stamp)
                now = RecordedTick(run, tick, stamp, published, waiting, values, [])
            waiting = []
        elif now is not None and convert_to_nanoseconds(message.header.stamp) == now.stamp:
            for field, row in arrange_truth(message, places).items():
                now.values.setdefault(f"true {field}", row)
    if now is not None:
        yield now


class JointPlaces:
    """Places of the scene's joints in messages, which have one order for long.

    Args:
        joints: of the scene.
        where: the bag, for refusals.
    """

    def __init__(self, joints: tuple[str, ...], where: str) -> None:
        self.where, self._joints = where, joints
        self._names: list[str] = []
        self._places: list[int] = []

    def find_places(self, names: list[str]) -> list[int]:
        """Return the places in a message with these names.

        Raises:
            Refusal: other joints.
        """
        if names != self._names or not self._places:
            if sorted(names) != sorted(self._joints):
                valid = ", ".join(self._joints)
                actual = ", ".join(names)
                raise Refusal(self.where, "joints", "be those of the scene", actual, valid)
            self._names, self._places = names, [names.index(name) for name in self._joints]
        return self._places


def arrange_state(
    state: MotorState, places: JointPlaces, only: Collection[str] | None = None
) -> dict[str, Values]:
    """Return `powered` and the values of a motor state by name, see `read_ticks`.

    Raises:
        Refusal: other joints, or readings of another number.
    """
    order = places.find_places(state.joint_names)
    values: dict[str, Values] = {"powered": np.array([state.powered])}
    for name in _LISTS:
        if only is not None and name not in only:
            continue
        row = np.array(getattr(state, name))
        values[name] = row[order] if len(row) == len(order) and name not in _OF_UNITS else row
    readings = np.array(state.readings)
    if len(readings) != len(order) * len(state.reading_names):
        rule = "have a value per name and joint"
        raise Refusal(places.where, "readings", rule, f"{len(readings)} values")
    for name, row in zip(state.reading_names, readings.reshape(-1, len(order)), strict=True):
        if only is None or name in only:
            values[str(name)] = row[order]
    return values


def arrange_truth(truth: JointState, places: JointPlaces) -> dict[str, Values]:
    """Return the true values of joint states, by field.

    Raises:
        Refusal: other joints, or values of another number.
    """
    order = places.find_places(truth.name)
    rows = {field: np.array(getattr(truth, field)) for field in TRUTH}
    for field, row in rows.items():
        check_length(places.where, field, row, len(order))
    return {field: row[order] for field, row in rows.items()}


def check_length(where: str, quantity: str, row: Values, count: int) -> None:
    """Refuse values of another number."""
    if len(row) != count:
        raise Refusal(where, quantity, f"have {count} values", f"{len(row)} values")


def find_first_difference_of_bits(
    recorded: Values, computed: Values
) -> tuple[int, tuple[Any, Any]] | None:
    """Return the first place that differs, by bits, and its values; None if all are equal."""
    computed = np.ascontiguousarray(computed, recorded.dtype)
    if recorded.tobytes() != computed.tobytes():
        # Of the bits: 0.0 and -0.0 differ, and a NaN is equal to itself.
        for place, (left, right) in enumerate(zip(recorded, computed, strict=True)):
            if left.tobytes() != right.tobytes():
                return place, (left.item(), right.item())
    return None
