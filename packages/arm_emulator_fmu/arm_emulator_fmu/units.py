"""Units as FMI defines them: powers of the base units of SI."""

import math
import re

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
    "degC": {"K": 1},
}

# Units that values are shown in: so many of them make one of the unit.
DISPLAYED = {
    "rad": ("deg", 180.0 / math.pi),
    "rad/s": ("deg/s", 180.0 / math.pi),
    "m": ("mm", 1e3),
    "m/s": ("mm/s", 1e3),
}
OFFSETS = {"degC": 273.15}  # of their zeros, in base units


def find_powers(name: str) -> dict[str, int] | None:
    """Return the powers of base units of a unit, such as ``N m s/rad``.

    None of one that is not of SI, such as counts.
    """
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
