"""Waves over the angle of a shaft, as a scene lists them."""

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.number import Number
from arm_emulator.base.validation.section import Section
from arm_emulator.machine import cxx_literals
from arm_emulator.machine.parts.key import Key

MAX_WAVES = 16  # waves of a shaft
_ORDER = Number("order", above=0.0, at_most=1e5)
_PHASE = Number.bound_size("phase", "rad", 1e4)

# Waves per turn of the shaft, amplitude, phase [rad].
Wave = tuple[float, float, float]


def declare_waves(name: str, unit: str, rule: str, text: str) -> Key:
    """Return the key of a list of waves; `rule`: of its amplitudes."""
    lists = f"up to {MAX_WAVES} lists `[k, a]` or `[k, a, phi]`: k > 0, ≤ 1e5; {rule}; phi ±1e4 rad"
    return Key(name, unit=unit, range=lists, absent="`[]`", text=text)


def read_waves(section: Section, key: str, unit: str) -> tuple[Wave, ...]:
    """Return the waves that a key lists, with amplitudes in `unit`.

    Raises:
        Refusal: no list of waves, or numbers out of their range.
    """
    entries = section.read_entries(key)
    if len(entries) > MAX_WAVES:
        raise section.make_refusal(key, f"have at most {MAX_WAVES} waves", len(entries))
    waves = []
    for entry in entries:
        if not isinstance(entry, list) or len(entry) not in (2, 3):
            rule = f"list waves of [order, amplitude in {unit}] or [order, amplitude, phase]"
            raise section.make_refusal(key, rule, repr(entry))
        numbers = [*entry, 0.0][:3]
        declared = (_ORDER, Number.bound_size("amplitude", unit, 1e3), _PHASE)
        for number, value in zip(declared, numbers, strict=True):
            if not number.is_in_range(value):
                raise section.make_refusal(
                    key, f"list waves whose {number.name} is a {number.range}", repr(entry)
                )
        waves.append((float(numbers[0]), float(numbers[1]), float(numbers[2])))
    return tuple(waves)


def compute_wave_sum(waves: tuple[Wave, ...], angle: Array) -> Array:
    """Return the sum of waves at angles of the shaft."""
    total = np.zeros_like(angle)
    for order, amplitude, phase in waves:
        total += amplitude * np.sin(order * angle + phase)
    return total


def compute_wave_slope(waves: tuple[Wave, ...], angle: Array) -> Array:
    """Return the derivative of `compute_wave_sum` in the angle."""
    total = np.zeros_like(angle)
    for order, amplitude, phase in waves:
        total += order * amplitude * np.cos(order * angle + phase)
    return total


def write_waves(waves: tuple[Wave, ...]) -> str:
    """Return waves in C++."""
    numbers = ("{" + ", ".join(map(cxx_literals.format_number, wave)) + "}" for wave in waves)
    return "{{" + ", ".join(numbers) + "}}"
