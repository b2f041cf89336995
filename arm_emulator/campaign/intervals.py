"""Confidence intervals of shares and of quantiles."""

from __future__ import annotations

import numpy as np
from scipy import special


def clopper_pearson(hits: int, count: int, confidence: float) -> tuple[float, float]:
    """Return the interval that holds the true share at least that often, whatever it is."""
    if count == 0:
        return 0.0, 1.0
    tail = 0.5 * (1.0 - confidence)
    low = 0.0 if hits == 0 else float(special.betaincinv(hits, count - hits + 1, tail))
    high = 1.0 if hits == count else float(special.betaincinv(hits + 1, count - hits, 1.0 - tail))
    return low, high


def quantile_places(q: float, count: int, confidence: float) -> tuple[int, int]:
    """Return the places in a sorted sample between which a quantile lies that often."""
    tail = 0.5 * (1.0 - confidence)
    below = special.bdtr(np.arange(count + 1), count, q)  # of at most so many smaller ones
    low = int(np.searchsorted(below, tail)) - 1
    high = int(np.searchsorted(below, 1.0 - tail))
    return max(0, low), min(count - 1, high)
