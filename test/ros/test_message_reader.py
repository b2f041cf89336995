"""Messages decoded and checked in C, against rclpy's decoding and rules written out here."""

import random
import struct
from array import array
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from draws import some
from rcl_interfaces.msg import ParameterValue
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import BatteryState, CameraInfo, Imu, JointState, Joy, LaserScan, NavSatFix
from trajectory_msgs.msg import JointTrajectory

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.number import Number
from arm_emulator.ros.c import MESSAGE_READER
from arm_emulator.ros.messages.message_reader import STAMP, MessageReader, RowBounds
from arm_emulator.ros.messages.middleware import get_middleware
from arm_emulator_msgs.msg import MotorCommand, MotorState, ServoState

# Between them fields of every kind: numbers of each width, flags, strings, arrays, messages.
KINDS = (
    MotorState, MotorCommand, ServoState, JointState, ParameterValue, BatteryState, CameraInfo, Imu,
    Joy, LaserScan, NavSatFix,
)  # fmt: skip
CODES = {
    "boolean": "?", "octet": "B", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h",
    "uint32": "I", "int32": "i", "uint64": "Q", "int64": "q", "float": "f", "double": "d",
}  # fmt: skip
NAMES = ("waist", "shoulder", "elbow", "é")
LARGEST = np.array([1.0, 2.0, 3.0, 4.0])
BOUND = Number.bound_size("position", "rad", LARGEST)


def encoded(message: Any, order: str) -> bytes:
    """Return a message in CDR, as the standard has it."""
    out = bytearray([0, order == "<", 0, 0])

    def put(code: str, *values: Any) -> None:
        size = struct.calcsize(f"={code}")
        out.extend(bytes((4 - len(out)) % size))
        out.extend(struct.pack(f"{order}{len(values)}{code}", *values))

    def put_text(text: str) -> None:
        put("I", len(text.encode()) + 1)
        out.extend(text.encode() + b"\0")

    def put_all(message: Any) -> None:
        for name, kind in message.get_fields_and_field_types().items():
            value = getattr(message, name)
            base = kind.removeprefix("sequence<").removesuffix(">").split("[")[0]
            if hasattr(value, "get_fields_and_field_types"):
                put_all(value)
                continue
            many = kind != base
            if kind.startswith("sequence"):
                put("I", len(value))
            for item in value if many else [value]:
                if base == "string":
                    put_text(item)
                else:
                    put(CODES[base], item[0] if isinstance(item, bytes) else item)

    put_all(message)
    return bytes(out)


def fill(draw: random.Random, message: Any) -> Any:
    """Draw all fields of a message; return it."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        base = kind.removeprefix("sequence<").removesuffix(">").split("[")[0]
        if hasattr(value, "get_fields_and_field_types"):
            fill(draw, value)
        elif kind == base:
            setattr(message, name, draw_value(draw, base))
        elif kind.startswith("sequence"):
            many = [draw_value(draw, base) for _ in range(draw.choice([0, 1, 2, 5]))]
            setattr(
                message, name, array(value.typecode, many) if hasattr(value, "typecode") else many
            )
        else:
            setattr(message, name, [draw_value(draw, base) for _ in value])
    return message


def draw_value(draw: random.Random, kind: str) -> Any:
    if kind == "string":
        return "".join(draw.choices("ax_1é", k=draw.randrange(9)))
    if kind == "boolean":
        return draw.random() < 0.5
    if kind == "octet":
        return bytes([draw.randrange(256)])
    if kind in ("float", "double"):
        return draw.choice([0.0, -1.5, 2.0**100, float("inf")])
    bits = 8 * struct.calcsize(f"={CODES[kind]}")
    lowest = 0 if kind.startswith("u") else -(2 ** (bits - 1))
    return draw.choice([lowest, lowest + 2**bits - 1, draw.randrange(lowest, lowest + 2**bits)])


def number() -> Any:
    return MESSAGE_READER.ffi.new("uint64_t *")


def read(reader: MessageReader, data: bytes) -> Refusal | None:
    """Read a message as C does; return why it is refused, None: it is not."""
    calls = get_middleware()
    if calls.message_open(reader.struct, data, len(data)):
        calls.message_rows(reader.struct)
    return reader.make_refusal(data)


def reader_of_nothing(kind: type) -> Callable[[bytes], bool]:
    """Return whether a reader that reads no field takes bytes for a message of a kind."""
    reader = MessageReader("topic", kind, (), "", {}, {})
    return lambda data: read(reader, data) is None


def is_message(kind: type, data: bytes) -> bool:
    try:
        deserialize_message(data, kind)
    except (RuntimeError, ValueError):
        return False
    return True


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("order", "<>")
def test_bytes_are_a_message_where_rclpy_takes_them(kind: type, order: str) -> None:
    draw, is_taken = random.Random(f"{kind.__name__} {order}"), reader_of_nothing(kind)
    for _ in range(some(range(100), 10)[-1]):
        message = fill(draw, kind())
        data = encoded(message, order)
        assert is_taken(serialize_message(message))
        assert deserialize_message(data, kind) == message
        assert is_taken(data) and is_taken(data + bytes(draw.randrange(9)))
        for length in range(len(data)):
            assert is_taken(data[:length]) == is_message(kind, data[:length]), length
        for _ in range(50):
            spoiled = bytearray(data)
            for _ in range(draw.randrange(1, 4)):
                spoiled[draw.randrange(4, len(data))] = draw.choice(
                    [0, 1, 2, 255, draw.randrange(256)]
                )
            assert is_taken(bytes(spoiled)) == is_message(kind, bytes(spoiled)), spoiled.hex()


def test_any_bytes_may_come() -> None:
    draw, takers = random.Random(3), [reader_of_nothing(kind) for kind in KINDS]
    for _ in some(range(3000), 1000):
        data = bytes(draw.choices([0, 1, 2, 255, *draw.randbytes(4)], k=draw.randrange(90)))
        for is_taken in takers:
            is_taken(data)
            is_taken(b"\0\1\0\0" + data)
    assert not any(is_taken(b"\0\2\0\0" + bytes(500)) for is_taken in takers), "no plain CDR"


class Joints:
    """A reader of motor states, and where it reads them to."""

    def __init__(self) -> None:
        self.counts, self.brakes = np.zeros((2, 4), np.int64)
        self.current, self.applied = np.zeros((2, 4))
        self.time, self.tick, self.powered = number(), number(), number()
        self.reader = MessageReader(
            "motor_states",
            MotorState,
            NAMES,
            "joint_names",
            {
                "encoder_counts": RowBounds(
                    self.counts, Number.bound_size("encoder_counts", "", 1e15)
                ),
                "current": RowBounds(self.current, BOUND.rename("current")),
                "applied": RowBounds(self.applied, BOUND.rename("applied"), is_optional=True),
                "brake_closed": RowBounds(
                    self.brakes, Number.bound_size("brake", "", 1), is_optional=True
                ),
            },
            {STAMP: self.time, "tick": self.tick, "powered": self.powered},
        )


def state(draw: random.Random) -> MotorState:
    """Return a sound state with its joints in any order."""
    message = fill(draw, MotorState())
    names = draw.sample(NAMES, 4)
    message.joint_names = names
    message.header.stamp.sec = draw.choice([0, 2**31 - 1, draw.randrange(1000)])
    message.header.stamp.nanosec = draw.choice([0, 999_999_999])
    message.encoder_counts = array("q", [draw.randrange(-(10**15), 10**15 + 1) for _ in names])
    for row in ("current", "applied"):
        values = [draw.uniform(-1, 1) * LARGEST[NAMES.index(name)] for name in names]
        setattr(message, row, array("d", values))
    message.brake_closed = array("q", draw.choice([[], [0, 1, -1, 1]]))
    if draw.random() < 0.2:
        message.applied = array("d")
    return message


def by_name(message: MotorState, row: str) -> list[float]:
    values = dict(zip(message.joint_names, getattr(message, row), strict=True))
    return [values[name] for name in NAMES]


@pytest.mark.parametrize("order", "<>")
def test_rows_are_read_in_the_receivers_order(order: str) -> None:
    draw, joints = random.Random(order), Joints()
    some_states = [state(draw) for _ in range(300)]
    for message in some_states + draw.choices(some_states, k=300):
        byte_order = draw.choice(["<", ">"]) if draw.random() < 0.2 else order
        assert read(joints.reader, encoded(message, byte_order)) is None
        assert by_name(message, "encoder_counts") == joints.counts.tolist()
        assert by_name(message, "current") == joints.current.tolist()
        if count := joints.reader.find_field("applied").came:
            assert by_name(message, "applied") == joints.applied.tolist()
        assert count == len(message.applied)
        if joints.reader.find_field("brake_closed").came:
            assert by_name(message, "brake_closed") == joints.brakes.tolist()
        stamp = message.header.stamp
        assert joints.time[0] == stamp.sec * 10**9 + stamp.nanosec
        assert (joints.tick[0], joints.powered[0]) == (message.tick, message.powered)


def spoiled(draw: random.Random) -> tuple[MotorState, str]:
    """Return a state that is refused, and how the refusal reads."""
    message, row = state(draw), draw.choice(["encoder_counts", "current", "brake_closed"])
    kind = draw.randrange(6)
    if kind == 0:
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = draw.choice([(-1, 0), (3, 10**9), (-(2**31), 2**32 - 1)])
        rule = "be a logical time >= 0 s, with less than 1e9 ns"
        return message, f"header.stamp must {rule}, got {stamp.sec} s and {stamp.nanosec} ns"
    if kind == 1:
        count = draw.choice([1, 3, 5])
        setattr(message, row, array(getattr(message, row).typecode, bytes(8 * count)))
        bound = {"brake_closed": "brake"}.get(row, row)
        return message, f"{bound} must have one value per joint name (4), got {count} values"
    if kind == 2:
        bad = draw.choice(["x", "waist", "Elbow", "elbow2", "elbo"])
        message.joint_names[draw.randrange(1, 4)] = (
            message.joint_names[0] if bad == "waist" else bad
        )
        names_text, valid = ", ".join(message.joint_names), ", ".join(NAMES)
        if bad != "waist":
            return message, f"joint must be one of the arm, got {bad}; valid: {valid}"
        return message, f"joint names must name every joint once, got {names_text}; valid: {valid}"
    if kind == 3:
        at, value = draw.randrange(4), draw.choice([10**15 + 1, -(2**63), 2**63 - 1])
        message.encoder_counts[at] = value
        count = f"encoder_counts of {message.joint_names[at]}"
        return message, f"{count} must be a number within +-1e+15, got {float(value)}"
    name = draw.choice(NAMES)
    at, largest = message.joint_names.index(name), LARGEST[NAMES.index(name)]
    value = draw.choice([np.nextafter(largest, 9), -largest - 1, np.inf, -np.inf, np.nan])
    message.current[at] = value
    rule = f"be a number within +-{largest:g} rad" if np.isfinite(value) else "be finite"
    return message, f"current of {name} must {rule}, got {float(value)}"


def test_a_refusal_names_rule_and_value() -> None:
    draw, joints, unused = random.Random(5), Joints(), Joints()
    for turn in some(range(2000), 400):
        message, words = spoiled(draw)
        order = draw.choice("<>")
        refusal = read(joints.reader, encoded(message, order))
        assert str(refusal) == f"motor_states: {words}", turn
        assert read(joints.reader, encoded(state(draw), order)) is None, "the next one is read"
    refusal = read(unused.reader, b"\0\1\0\0" + bytes(20))
    assert str(refusal) == "motor_states: message must be a MotorState, got 24 bytes"


def test_texts_end_at_their_first_zero() -> None:
    """As rclpy reads them; a text may also lack its end, or be of no bytes."""
    joints, message = Joints(), state(random.Random(7))
    message.joint_names, message.current, message.applied = list(NAMES), array("d", bytes(32)), []
    data = encoded(message, "<")
    for written in (b"\6\0\0\0waist\0\0\0", b"\5\0\0\0waist\0\0\0", b"\10\0\0\0waist\0xy"):
        spoiled = data.replace(b"\6\0\0\0waist\0\0\0", written)
        assert deserialize_message(spoiled, MotorState).joint_names == list(NAMES)
        assert read(joints.reader, spoiled) is None
    none = data.replace(b"\3\0\0\0\xc3\xa9\0", b"\0\0\0\0\xc3\xa9\0")
    assert read(joints.reader, none) is not None


def test_a_reader_of_a_different_type_is_not_constructed() -> None:
    row = {"current": RowBounds(np.zeros(3), BOUND)}
    for rows, singles in (
        (row, {}),
        ({"current": RowBounds(np.zeros(4, np.int64), BOUND)}, {}),
        ({}, {"nonesuch": number()}),
    ):
        with pytest.raises(TypeError):
            MessageReader("topic", MotorState, NAMES, "joint_names", rows, singles)
    with pytest.raises(TypeError, match="points"):
        MessageReader("topic", JointTrajectory, NAMES, "joint_names", {}, {})
