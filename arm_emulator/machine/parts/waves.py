"""Waves that go with the angle of a shaft, as a scene lists them."""

from __future__ import annotations

import numpy as np

from arm_emulator.base.section import Section
from arm_emulator.machine import cxx_literals
from arm_emulator.machine.chain import Array

MOST = 16  # waves of a shaft
LARGEST_ORDER = 1e5

# Waves per turn of the shaft, amplitude, phase [rad].
Wave = tuple[float, float, float]


def read_waves(section: Section, key: str, unit: str) -> tuple[Wave, ...]:
    """Return the waves that a key lists, with amplitudes in `unit`.

    Raises:
        Refusal: no list of waves, or numbers out of their range.
    """
    entries = section.entries(key)
    if len(entries) > MOST:
        raise section.refusal(key, f"have at most {MOST} waves", len(entries))
    waves = []
    for entry in entries:
        if not isinstance(entry, list) or len(entry) not in (2, 3):
            rule = f"list waves of [order, amplitude in {unit}] or [order, amplitude, phase]"
            raise section.refusal(key, rule, repr(entry))
        numbers = [*entry, 0.0][:3]
        for value, most in zip(numbers, (LARGEST_ORDER, 1e3, 1e4), strict=True):
            sound = isinstance(value, int | float) and not isinstance(value, bool)
            if not sound or not abs(value) <= most:
                rule = (
                    "list waves of numbers, order up to 1e5, amplitude up to 1e3, phase up to 1e4"
                )
                raise section.refusal(key, rule, repr(entry))
        if numbers[0] <= 0.0:
            raise section.refusal(key, "have waves of orders > 0", repr(entry))
        waves.append((float(numbers[0]), float(numbers[1]), float(numbers[2])))
    return tuple(waves)


def wave_sum(waves: tuple[Wave, ...], angle: Array) -> Array:
    """Return the sum of waves at angles of the shaft."""
    total = np.zeros_like(angle)
    for order, amplitude, phase in waves:
        total += amplitude * np.sin(order * angle + phase)
    return total


def wave_slope(waves: tuple[Wave, ...], angle: Array) -> Array:
    """Return the derivative of `wave_sum` in the angle."""
    total = np.zeros_like(angle)
    for order, amplitude, phase in waves:
        total += order * amplitude * np.cos(order * angle + phase)
    return total


def cxx_waves(waves: tuple[Wave, ...]) -> str:
    """Return waves in C++."""
    numbers = ("{" + ", ".join(map(cxx_literals.number, one)) + "}" for one in waves)
    return "{{" + ", ".join(numbers) + "}}"
