"""Random numbers of parts, as sections of a scene state them."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

# A name: NumPy loads its generators, 3 % of the start of a plant, where one is first asked for.
Rng: TypeAlias = "np.random.Generator"
Numbers = dict[str, Any]


def scaled(rng: Rng, low: float, high: float) -> float:
    """Draw a number of any scale between two: its logarithm is uniform."""
    return float(10 ** rng.uniform(np.log10(low), np.log10(high)))


def usual(rng: Rng, low: float, high: float) -> float:
    """Draw a number between two; of any scale where both are above 0."""
    return scaled(rng, low, high) if low > 0.0 else float(rng.uniform(low, high))
