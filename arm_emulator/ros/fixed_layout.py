"""Messages of which only numbers change: serialised once, with the numbers updated in place.

rclpy converts every field of a message to Python and back, names and lengths too: for the two
messages of a servo period this takes longer than the middleware does. Here the bytes are laid out
once; then numbers are read and written in place.

Format of the bytes: plain CDR (OMG DDSI-RTPS 2.5, section 10), as all ROS 2 middlewares send.
"""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
from rclpy.serialization import serialize_message

_KINDS = {
    "boolean": "?", "octet": "B", "byte": "B", "char": "B", "uint8": "B", "int8": "b",
    "uint16": "H", "int16": "h", "uint32": "I", "int32": "i", "uint64": "Q", "int64": "q",
    "float": "f", "double": "d",
}  # fmt: skip
_HEADER = 4  # bytes: the kind of encoding


class FixedLayout:
    """The bytes of one message with constant strings and lengths.

    Attributes:
        message: its fields under their names. Numbers are to be set; arrays of numbers are NumPy
            arrays, to be written into, which the next `take` overwrites.
        bytes: the message, to be written into by code in C, at `places`.
        places: where each number, or array of numbers, begins, by names with dots; -1: an empty
            array.

    Args:
        message: with its final strings and lengths of arrays.

    Raises:
        TypeError: a field is an array of messages.
    """

    def __init__(self, message: Any) -> None:
        data = serialize_message(message)
        self.bytes = bytearray(data)
        self.places: dict[str, int] = {}
        self._order: Literal["<", ">"] = "<" if data[1] & 1 else ">"
        self._fixed: list[tuple[int, bytes]] = [(0, bytes(data[:_HEADER]))]
        self._numbers: list[tuple[Any, str, struct.Struct, int]] = []
        self._at = _HEADER
        self.message: Any = self._laid_out(message)
        self.size = self._at  # bytes after it are padding

    def data(self) -> bytes:
        """Return the message as it is sent."""
        return bytes(self.written()[: self.size])

    def written(self) -> bytearray:
        """Write all numbers into `bytes`, and return them."""
        for owner, name, kind, at in self._numbers:
            kind.pack_into(self.bytes, at, getattr(owner, name))
        return self.bytes

    def take(self, data: bytes) -> bool:
        """Load a received message; False if strings, lengths or encoding differ."""
        size = self.size
        if len(data) < size:
            return False
        for at, same in self._fixed:
            if not data.startswith(same, at):
                return False
        self.bytes[:size] = data[:size]
        for owner, name, kind, at in self._numbers:
            setattr(owner, name, kind.unpack_from(data, at)[0])
        return True

    def _laid_out(self, message: Any, within: str = "") -> SimpleNamespace:
        one = SimpleNamespace()
        for name, kind in message.get_fields_and_field_types().items():
            setattr(one, name, self._field(one, name, kind, getattr(message, name), within))
        return one

    def _field(self, owner: SimpleNamespace, name: str, kind: str, value: Any, within: str) -> Any:
        path = within + name
        if kind in _KINDS:
            at = self.places[path] = self._skip(_KINDS[kind])
            self._numbers.append((owner, name, struct.Struct(self._order + _KINDS[kind]), at))
            return value
        if kind == "string":
            self._string(value)
            return value
        if kind == "sequence<string>":
            self._length(len(value))
            for text in value:
                self._string(text)
            return list(value)
        base = kind.removeprefix("sequence<").split("[")[0].removesuffix(">")
        if base in _KINDS:
            if kind.startswith("sequence<"):
                self._length(len(value))
            return self._array(path, _KINDS[base], len(value))
        if kind == base:
            return self._laid_out(value, f"{path}.")
        raise TypeError(f"no fixed layout for {name}: {kind}")

    def _skip(self, kind: str, count: int = 1) -> int:
        """Skip numbers of a kind, aligned to their size."""
        size = struct.calcsize("=" + kind)
        at = self._at + (_HEADER - self._at) % size
        self._at = at + count * size
        return at

    def _array(self, path: str, kind: str, count: int) -> np.ndarray[Any, Any]:
        dtype = np.dtype(kind).newbyteorder(self._order)
        at = self._skip(kind, count) if count else 0
        self.places[path] = at if count else -1
        return np.ndarray((count,), dtype, self.bytes, at)

    def _length(self, length: int) -> None:
        self._keep(self._skip("I"), struct.pack(self._order + "I", length))

    def _string(self, text: str) -> None:
        encoded = text.encode() + b"\0"
        self._length(len(encoded))
        self._keep(self._at, encoded)
        self._at += len(encoded)

    def _keep(self, at: int, same: bytes) -> None:
        last, before = self._fixed[-1]
        if at == last + len(before):
            self._fixed[-1] = last, before + same
        else:
            self._fixed.append((at, same))
