"""Messages of which only numbers change: serialised once, with the numbers updated in place.

rclpy converts every field of a message to Python and back, names and lengths too: for the two
messages of a servo period this takes longer than the middleware does. Here the bytes are laid out
once; then numbers are read and written in place.
"""

import re
import struct
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
from rclpy.serialization import serialize_message

_HEADER = 4  # bytes before the first field: the kind of encoding
CODES = {  # of numbers, as of module struct
    "boolean": "?", "octet": "B", "byte": "B", "char": "B", "uint8": "B", "int8": "b",
    "uint16": "H", "int16": "h", "uint32": "I", "int32": "i", "uint64": "Q", "int64": "q",
    "float": "f", "double": "d",
}  # fmt: skip
_KIND = re.compile(r"sequence<(?P<many>\w+)>|(?P<one>\w+)(?:\[(?P<count>\d+)\])?")


def list_typed_fields(message: Any, within: str = "") -> Iterator[tuple[str, str, int, Any]]:
    """Yield the fields of a message and of messages within it, in the order of their bytes.

    Of each its name, with dots; its kind, of `CODES` or string; the length of an array, 0 of a
    single one, -1 of a sequence; its value.

    Raises:
        TypeError: a field of another kind, such as an array of messages.
    """
    for name, kind in message.get_fields_and_field_types().items():
        path, value = within + name, getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            yield from list_typed_fields(value, f"{path}.")
            continue
        match = _KIND.fullmatch(kind)
        base = match and (match["many"] or match["one"])
        if match is None or base not in (*CODES, "string"):
            raise TypeError(f"{path} is a {kind}, which has no fixed layout")
        yield path, str(base), -1 if match["many"] else int(match["count"] or 0), value


class FixedLayout:
    """The bytes of one message with constant strings and lengths.

    Attributes:
        message: its fields under their names. Numbers are to be set; arrays of numbers are NumPy
            arrays, to be written into, which the next `load_message` overwrites.
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
        self.message: Any = self._list_places(message)
        self.size = self._at  # bytes after it are padding

    def write_message(self) -> bytes:
        """Return the message as it is sent."""
        return bytes(self.write_numbers()[: self.size])

    def write_numbers(self) -> bytearray:
        """Write all numbers into `bytes`, and return them."""
        for owner, name, kind, at in self._numbers:
            kind.pack_into(self.bytes, at, getattr(owner, name))
        return self.bytes

    def load_message(self, data: bytes) -> bool:
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

    def _list_places(self, message: Any) -> SimpleNamespace:
        root = SimpleNamespace()
        for path, kind, count, value in list_typed_fields(message):
            *within, name = path.split(".")
            owner = root
            for group in within:
                owner = vars(owner).setdefault(group, SimpleNamespace())
            if count < 0:
                self._add_length(len(value))
            setattr(owner, name, self._add_field(owner, path, kind, count, value))
        return root

    def _add_field(
        self, owner: SimpleNamespace, path: str, kind: str, count: int, value: Any
    ) -> Any:
        if kind == "string":
            for text in value if count else [value]:
                self._add_string(text)
            return list(value) if count else value
        if count:
            return self._add_array(path, CODES[kind], len(value))
        at = self.places[path] = self._skip_numbers(CODES[kind])
        code = struct.Struct(self._order + CODES[kind])
        self._numbers.append((owner, path.rpartition(".")[2], code, at))
        return value

    def _skip_numbers(self, kind: str, count: int = 1) -> int:
        """Skip numbers of a kind, aligned to their size."""
        size = struct.calcsize("=" + kind)
        at = self._at + (_HEADER - self._at) % size
        self._at = at + count * size
        return at

    def _add_array(self, path: str, kind: str, count: int) -> np.ndarray[Any, Any]:
        dtype = np.dtype(kind).newbyteorder(self._order)
        at = self._skip_numbers(kind, count) if count else 0
        self.places[path] = at if count else -1
        return np.ndarray((count,), dtype, self.bytes, at)

    def _add_length(self, length: int) -> None:
        self._add_constant(self._skip_numbers("I"), struct.pack(self._order + "I", length))

    def _add_string(self, text: str) -> None:
        encoded = text.encode() + b"\0"
        self._add_length(len(encoded))
        self._add_constant(self._at, encoded)
        self._at += len(encoded)

    def _add_constant(self, at: int, same: bytes) -> None:
        last, before = self._fixed[-1]
        if at == last + len(before):
            self._fixed[-1] = last, before + same
        else:
            self._fixed.append((at, same))
