"""Numbers as C++ writes them."""

from collections.abc import Mapping, Sequence

from arm_emulator.base.arrays import Array


def format_number(value: float) -> str:
    """Return a number to its last bit; 0 without a sign."""
    return repr(float(value) + 0.0)


def format_fields(numbers: Mapping[str, float]) -> str:
    """Return designated initialisers."""
    return ", ".join(f".{name} = {format_number(value)}" for name, value in numbers.items())


def format_vector(values: Sequence[float] | Array) -> str:
    """Return a Vec3."""
    return f"{{{format_fields(dict(zip('xyz', values, strict=True)))}}}"
