"""Units as FMI defines them: powers of the base units of SI."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")

_DERIVED = {
    **{name: {name: 1} for name in BASE},
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "ohm": {"kg": 1, "m": 2, "s": -3, "A": -2},
    "H": {"kg": 1, "m": 2, "s": -2, "A": -2},
    "Hz": {"s": -1},
    "1": {},
}


@dataclass(frozen=True)
class DisplayUnit:
    """A unit for display: so many of it make one of the unit."""

    name: str
    factor: float


_DISPLAYED = {
    "rad": DisplayUnit("deg", 180.0 / math.pi),
    "rad/s": DisplayUnit("deg/s", 180.0 / math.pi),
    "m": DisplayUnit("mm", 1e3),
    "m/s": DisplayUnit("mm/s", 1e3),
}


@dataclass(frozen=True)
class Unit:
    """A unit; `powers` of base units is None where it is not of SI, such as counts."""

    name: str
    powers: dict[str, int] | None
    offset: float = 0.0  # in base units, of its zero
    displayed: tuple[DisplayUnit, ...] = field(default=())


def unit_of(name: str) -> Unit:
    """Return the unit that is written so, such as ``N m s/rad``."""
    displayed = (_DISPLAYED[name],) if name in _DISPLAYED else ()
    if name == "degC":
        return Unit(name, {"K": 1}, 273.15)
    return Unit(name, _powers(name), displayed=displayed)


def displayed_in(name: str | None) -> str | None:
    """Return the name of the unit that values are shown in, if it is another one."""
    return _DISPLAYED[name].name if name in _DISPLAYED else None


def _powers(name: str) -> dict[str, int] | None:
    total = dict.fromkeys(BASE, 0)  # a name without a unit is a ratio
    above, *below = name.split("/")
    terms = [(text, 1) for text in above.split()]
    terms += [(text, -1) for part in below for text in part.strip("()").split()]
    for text, sign in terms:
        match = re.fullmatch(r"(1|[A-Za-z]+?)(\d*)", text)
        powers = _DERIVED.get(match[1]) if match else None
        if match is None or powers is None:
            return None
        for base, power in powers.items():
            total[base] += sign * power * int(match[2] or 1)
    return {base: power for base, power in total.items() if power}
