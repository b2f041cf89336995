"""Numbers as C++ writes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from arm_emulator.base.arrays import Array


def number(value: float) -> str:
    """Return a number to its last bit; 0 without a sign."""
    return repr(float(value) + 0.0)


def fields(numbers: Mapping[str, float]) -> str:
    """Return designated initialisers."""
    return ", ".join(f".{name} = {number(value)}" for name, value in numbers.items())


def vector(values: Sequence[float] | Array) -> str:
    """Return a Vec3."""
    return f"{{{fields(dict(zip('xyz', values, strict=True)))}}}"
