"""Bytes of messages whose numbers alone change, against rclpy's own."""

import random
from array import array
from typing import Any

import pytest
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Header

from arm_emulator.ros.messages.fixed_layout import FixedLayout
from arm_emulator_msgs.msg import MotorCommand, MotorState

KINDS = (MotorState, MotorCommand)


def number(draw: random.Random, kind: str) -> Any:
    if kind == "boolean":
        return draw.random() < 0.5
    if kind in ("double", "sequence<double>"):
        return draw.choice([0.0, -0.0, 1e308, 5e-324, float("inf"), draw.uniform(-9.0, 9.0)])
    smallest, largest = {"uint64": (0, 2**64 - 1)}.get(kind, (-(2**63), 2**63 - 1))
    return draw.choice([smallest, largest, draw.randint(smallest, largest)])


def renumber(draw: random.Random, message: Any) -> None:
    message.header.stamp.sec = draw.randint(-(2**31), 2**31 - 1)
    message.header.stamp.nanosec = draw.randint(0, 2**32 - 1)
    for name, kind in message.get_fields_and_field_types().items():
        if kind.startswith("sequence<") and "string" not in kind:
            value = getattr(message, name)
            samples = [number(draw, kind) for _ in value]
            setattr(message, name, array(value.typecode, samples))
        elif kind in ("boolean", "uint64"):
            setattr(message, name, number(draw, kind))


def text(draw: random.Random) -> str:
    return "".join(draw.choices("ax_1é", k=draw.randrange(12)))


def random_message(draw: random.Random, kind: type) -> Any:
    message = kind()
    message.header.frame_id = text(draw)
    for name, field in message.get_fields_and_field_types().items():
        if field == "sequence<string>":
            setattr(message, name, [text(draw) for _ in range(draw.randrange(5))])
        elif field.startswith("sequence<"):
            count, typecode = draw.randrange(5), getattr(message, name).typecode
            setattr(message, name, array(typecode, bytes(8 * count)))
    renumber(draw, message)
    return message


def fill(fields: Any, message: Any) -> None:
    stamp = fields.header.stamp
    stamp.sec, stamp.nanosec = message.header.stamp.sec, message.header.stamp.nanosec
    for name, kind in message.get_fields_and_field_types().items():
        if kind in ("boolean", "uint64"):
            setattr(fields, name, getattr(message, name))
        elif kind.startswith("sequence<") and "string" not in kind:
            getattr(fields, name)[:] = getattr(message, name)


def assert_same(fields: Any, message: Any) -> None:
    stamp = message.header.stamp
    assert (fields.header.stamp.sec, fields.header.stamp.nanosec) == (stamp.sec, stamp.nanosec)
    assert fields.header.frame_id == message.header.frame_id, "frame"
    for name in message.get_fields_and_field_types():
        if name != "header":
            assert list_of(getattr(fields, name)) == list_of(getattr(message, name)), name


def list_of(value: Any) -> Any:
    return value if isinstance(value, (bool, int)) else list(value)


@pytest.mark.parametrize("kind", KINDS)
def test_numbers_are_written_and_read_where_rclpy_has_them(kind: type) -> None:
    draw = random.Random(kind.__name__)
    for _ in range(100):
        message = random_message(draw, kind)
        printed, heard = FixedLayout(message), FixedLayout(message)
        for _ in range(3):
            renumber(draw, message)
            fill(printed.message, message)
            assert deserialize_message(printed.write_message(), kind) == message, "written"
            assert heard.load_message(serialize_message(message)), "the same names and lengths"
            assert_same(heard.message, message)


@pytest.mark.parametrize("kind", KINDS)
def test_changed_names_and_lengths_are_not_taken(kind: type) -> None:
    draw = random.Random(1)
    some = [random_message(draw, kind) for _ in range(20)]
    for message in some:
        heard = FixedLayout(message)
        for second in some:
            data = serialize_message(second)
            same = len(data) == len(heard.bytes) and names_of(second) == names_of(message)
            if heard.load_message(data):
                assert same
                assert_same(heard.message, second)
        assert heard.load_message(serialize_message(message) + bytes(draw.randrange(8)))
        assert not heard.load_message(b"") and not heard.load_message(
            serialize_message(message)[: heard.size - 1]
        )


def names_of(message: Any) -> list[str]:
    return [message.header.frame_id, *message.joint_names]


def test_arrays_of_messages_have_no_fixed_layout() -> None:
    from diagnostic_msgs.msg import DiagnosticArray

    with pytest.raises(TypeError, match="status"):
        FixedLayout(DiagnosticArray())
    assert FixedLayout(Header(frame_id="a")).message.frame_id == "a"
