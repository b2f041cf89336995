"""Bytes of messages whose numbers alone change, against rclpy's own."""

import random
from array import array
from typing import Any

import pytest
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Header

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.fixed_layout import FixedLayout, Taking
from arm_emulator_msgs.msg import MotorCommand, MotorState

KINDS = (MotorState, MotorCommand)


def number(draw: random.Random, kind: str) -> Any:
    if kind == "boolean":
        return draw.random() < 0.5
    if kind in ("double", "sequence<double>"):
        return draw.choice([0.0, -0.0, 1e308, 5e-324, float("inf"), draw.uniform(-9.0, 9.0)])
    least, most = {"uint64": (0, 2**64 - 1)}.get(kind, (-(2**63), 2**63 - 1))
    return draw.choice([least, most, draw.randint(least, most)])


def renumber(draw: random.Random, message: Any) -> None:
    """Draw all numbers of a message; names and lengths stay."""
    message.header.stamp.sec = draw.randint(-(2**31), 2**31 - 1)
    message.header.stamp.nanosec = draw.randint(0, 2**32 - 1)
    for name, kind in message.get_fields_and_field_types().items():
        if kind.startswith("sequence<") and "string" not in kind:
            value = getattr(message, name)
            drawn = [number(draw, kind) for _ in value]
            setattr(message, name, array(value.typecode, drawn))
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
    """Set the numbers of a layout as a node does."""
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
            assert deserialize_message(printed.data(), kind) == message, "written"
            assert heard.take(serialize_message(message)), "the same names and lengths"
            assert_same(heard.message, message)


@pytest.mark.parametrize("kind", KINDS)
def test_other_names_lengths_and_senders_are_heard_as_well(kind: type) -> None:
    draw, heard, refused = random.Random(1), [], []
    take = Taking(
        "topic",
        kind,
        lambda fields, data: heard.append((fields, data)),
        lambda topic, reason: refused.append(reason),
    ).take
    some = [random_message(draw, kind) for _ in range(5)]
    for _ in range(100):
        message, slack = draw.choice(some), bytes(draw.randrange(8))
        data = serialize_message(message) + slack
        take(data)
        fields, same = heard.pop()
        assert_same(fields, message)
        assert same == data, "the bytes as they came"
    assert not refused and not heard, "each is handed on once"


def test_bytes_that_are_no_message_are_refused_in_a_line() -> None:
    draw, heard = random.Random(2), []
    refused: list[Refusal] = []
    take = Taking(
        "motor_commands",
        MotorCommand,
        lambda fields, _: heard.append(fields),
        lambda _, reason: refused.append(reason),
    ).take
    whole = serialize_message(random_message(draw, MotorCommand))
    for length in (0, 1, 3, 4, 9, 17, 30):
        take(bytes(whole[:length]))
    for reason in refused:
        assert "motor_commands: message must be a MotorCommand" in str(reason)
    assert len(refused) + len(heard) == 7 and refused, "each is refused or handed on"


def test_arrays_of_messages_have_no_fixed_layout() -> None:
    from diagnostic_msgs.msg import DiagnosticArray

    with pytest.raises(TypeError, match="status"):
        FixedLayout(DiagnosticArray())
    assert FixedLayout(Header(frame_id="a")).message.frame_id == "a"
