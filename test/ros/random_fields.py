"""Messages and requests of any type, filled with random values of the types of their fields."""

import importlib
import random
import re
from collections.abc import Sequence
from typing import Any

from random_messages import number, text

_SIZES = (8, 16, 32, 64)
_BITS = {kind: (0, 8) for kind in ("char", "byte", "octet")}  # whether signed, and bits
_BITS |= {f"int{bits}": (1, bits) for bits in _SIZES} | {
    f"uint{bits}": (0, bits) for bits in _SIZES
}


def class_of(name: str) -> Any:
    """Return the class of a type, such as "std_msgs/msg/String" or "std_msgs/String"."""
    package, *module, kind = name.split("/")
    return getattr(importlib.import_module(".".join((package, *(module or ["msg"])))), kind)


def fill(rng: random.Random, message: Any, words: Sequence[str], sound: float = 0.3) -> Any:
    """Fill a message.

    Args:
        rng: draws.
        message: of any type.
        words: texts that mean something to the receiver.
        sound: share of fields that keep their values.
    """
    for field, kind in message.get_fields_and_field_types().items():
        if rng.random() >= sound:
            setattr(message, field, _value(rng, kind, words))
    return message


def _value(rng: random.Random, kind: str, words: Sequence[str]) -> Any:
    if sequence := re.fullmatch(r"sequence<(.*?)(?:, (\d+))?>", kind):
        limit = int(sequence[2] or 6)
        return _values(rng, sequence[1], rng.randint(0, min(limit, 6)), words)
    if array := re.fullmatch(r"(.*)\[(\d+)\]", kind):
        return _values(rng, array[1], int(array[2]), words)
    if kind == "boolean":
        return rng.random() < 0.5
    if kind in _BITS:
        signed, bits = _BITS[kind]
        integer = rng.choice((0, 1, 2, 3, 99, rng.getrandbits(bits)))
        integer = integer % 2**bits - (2 ** (bits - 1) if signed and rng.random() < 0.3 else 0)
        limit = 2 ** (bits - signed) - 1
        integer = max(-limit - 1 if signed else 0, min(limit, integer))
        return bytes([integer]) if kind in ("byte", "octet") else integer
    if kind in ("float", "double"):
        value = rng.choice((0.0, rng.gauss(0.0, 1.0), number(rng)))
        return value if kind == "double" or abs(value) < 3e38 else 0.0
    if kind.startswith(("string", "wstring")):
        return rng.choice((text(rng), *(rng.choice(words) for _ in range(4))))
    return fill(rng, class_of(kind)(), words)


def _values(rng: random.Random, kind: str, count: int, words: Sequence[str]) -> Any:
    values = [_value(rng, kind, words) for _ in range(count)]
    return b"".join(values) if kind in ("byte", "octet") else values
