"""Messages of joints, decoded and checked in C (c/message_reader.h)."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.joint_order import JointOrder
from arm_emulator.base.validation.number import LARGEST, Number
from arm_emulator.ros.c import MESSAGE_READER
from arm_emulator.ros.messages.fixed_layout import CODES, list_typed_fields
from arm_emulator.ros.messages.time_stamp import check_time
from arm_emulator.toolchain.c_header import CData

STAMP = "header.stamp.sec"  # stands for the whole time
_READ, _OF_ITS_TYPE, _OF_A_TIME = map(
    MESSAGE_READER.get_constant, ("MESSAGE_READ", "MESSAGE_OF_ITS_TYPE", "MESSAGE_OF_A_TIME")
)


@dataclass(frozen=True)
class RowBounds:
    """Numbers of a message, one per joint.

    Attributes:
        to: where they are read to, in the receiver's order of joints (N,), int64 or float64.
        bound: of their sizes.
        is_optional: whether the message may have none.
    """

    to: NDArray[Any]
    bound: Number
    is_optional: bool = False


class MessageReader:
    """Reads the messages of a topic.

    Fields are named with dots, those of messages within included.

    Attributes:
        struct: ``message_reader *``.

    Args:
        topic: for refusals.
        kind: of the messages.
        joint_names: in the receiver's order.
        names: the field with the joints of a message; empty: there are no rows.
        rows: numbers of joints, by field.
        singles: pointers to 8 bytes each, by field, for flags, numbers of 8 bytes, and the
            nanoseconds of `STAMP`.

    Raises:
        TypeError: a field that cannot be read, or an array of messages.
    """

    def __init__(
        self,
        topic: str,
        kind: type,
        joint_names: Sequence[str],
        names: str,
        rows: Mapping[str, RowBounds],
        singles: Mapping[str, CData],
    ) -> None:
        assert names or not rows
        self._topic, self._kind, self._names, self._rows = topic, kind, names, rows
        self._order = JointOrder(topic, joint_names)
        self._at: dict[str, int] = {}  # number of each field
        N, new = len(joint_names), MESSAGE_READER.ffi.new
        table = [*list_typed_fields(kind())]
        self._fields = new("message_field[]", len(table))
        self._referenced: list[object] = []  # what the fields point to
        for k, (path, type_, count, _) in enumerate(table):
            field, self._at[path] = self._fields + k, k
            field.width = 0 if type_ == "string" else struct.calcsize(f"={CODES[type_]}")
            field.count = count or 1
            field.is_flag, field.is_real = type_ == "boolean", type_ == "double"
            if path == names:
                use = "MESSAGE_NAMES"
            elif path in rows:
                use = "MESSAGE_ROW"
                self._read_row_into(field, type_, rows[path], N)
            elif path in singles:
                use = "MESSAGE_TIME" if path == STAMP else "MESSAGE_NUMBER"
                if path != STAMP and field.width != 8 and not field.is_flag:
                    raise TypeError(f"{path} is a {type_}, which is not read")
                field.to = singles[path]
            else:
                use = "MESSAGE_SKIPPED"
            field.use = MESSAGE_READER.get_constant(use)
        if missing := {names, *rows, *singles} - {"", *self._at}:
            raise TypeError(f"{kind.__name__} has no {missing}")
        encoded = [new("char[]", name.encode()) for name in joint_names]
        self._joints = new("char *[]", encoded)
        self._place = np.zeros(N, np.int64)
        # A length, then of each name its length, its bytes and their end, to a multiple of 4.
        self._known_bytes = np.zeros(4 + sum(4 + len(name) + 3 for name in encoded), np.uint8)
        self._referenced += encoded
        self.struct = MESSAGE_READER.make_struct(
            "message_reader",
            fields=len(table),
            field=self._fields,
            joints=N,
            name=self._joints,
            place=self._place,
            known=self._known_bytes,
            known_room=len(self._known_bytes),
            names=self._at.get(names, 0),
        )

    def find_field(self, path: str) -> CData:
        """Return the ``message_field *`` of a field."""
        return self._fields + self._at[path]

    def make_refusal(self, data: bytes) -> Refusal | None:
        """Return why a message was refused that was read last, of these bytes; None: it was not."""
        rule = self.struct.rule
        if rule == _READ:
            return None
        if rule == _OF_ITS_TYPE:
            return refuse_bytes(self._topic, self._kind, data)
        message: Any = deserialize_message(data, self._kind)
        path = next(name for name, k in self._at.items() if k == self.struct.refused)
        try:  # C has refused it: these have the words
            if rule == _OF_A_TIME:
                check_time(self._topic, message.header.stamp)
            else:
                names, values = getattr(message, self._names), getattr(message, path)
                self._order.arrange_values(names, values, self._rows[path].bound)
        except Refusal as reason:
            return reason
        return Refusal(self._topic, path, "be readable", "another value")  # C alone knows why

    def _read_row_into(self, field: CData, type_: str, row: RowBounds, N: int) -> None:
        kind = {"double": np.float64, "int64": np.int64}.get(type_)
        if kind is None or row.to.dtype != kind or row.to.shape != (N,):
            raise TypeError(f"{type_} cannot be read into {row.to.dtype}, {row.to.shape}")
        bound = row.bound
        assert bound.in_size and bound.above is bound.at_least is None and not bound.whole
        largest = LARGEST if bound.at_most is None else bound.at_most
        maxima = np.array(np.broadcast_to(largest, N), np.float64)
        self._referenced += [row.to, maxima]
        MESSAGE_READER.fill_struct(field, most=maxima, is_optional=row.is_optional)
        field.to = MESSAGE_READER.ffi.cast("void *", row.to.ctypes.data)


def refuse_bytes(topic: str, kind: type, data: bytes) -> Refusal:
    """Return the refusal of bytes that are no message of a kind."""
    return Refusal(topic, "message", f"be a {kind.__name__}", f"{len(data)} bytes")
