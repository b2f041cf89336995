"""Numbers and texts as C++ writes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from arm_emulator.machine.chain import Array


def number(value: float) -> str:
    """Return a number to its last bit; 0 without a sign."""
    return repr(float(value) + 0.0)


def fields(numbers: Mapping[str, float]) -> str:
    """Return designated initialisers."""
    return ", ".join(f".{name} = {number(value)}" for name, value in numbers.items())


def vector(values: Sequence[float] | Array) -> str:
    """Return a Vec3."""
    return f"{{{fields(dict(zip('xyz', values, strict=True)))}}}"


def text(words: str) -> str:
    """Return a string literal of plain ASCII."""
    plain = "".join(c if c.isascii() and c.isalnum() else _octal(c) for c in words)
    return f'"{plain}"'


def _octal(character: str) -> str:
    return "".join(f"\\{byte:03o}" for byte in character.encode())
