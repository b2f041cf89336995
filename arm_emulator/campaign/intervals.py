"""Confidence intervals of shares, of quantiles, and of means of repeated estimates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
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


def of_repetitions(p: NDArray[np.float64], confidence: float) -> tuple[float, float]:
    """Return the interval of the mean of independent estimates of a probability (K,).

    They are taken to be lognormal, as products of many shares are: Cox's interval of such a mean
    (Zhou and Gao, Statistics in Medicine 16, 1997), with Student's quantile. If one is 0, the
    low end is 0 and the high end that of Student's interval of the values themselves.
    """
    K = len(p)
    t = float(special.stdtrit(K - 1, 0.5 * (1.0 + confidence)))
    if not np.all(p > 0.0):
        high = float(np.mean(p) + t * np.std(p, ddof=1) / np.sqrt(K))
        return 0.0, min(1.0, high) if high > 0.0 else 1.0
    logs = np.log(p)
    s2 = float(np.var(logs, ddof=1))
    middle = float(np.mean(logs)) + 0.5 * s2
    half = t * np.sqrt(s2 / K + 0.5 * s2 * s2 / (K - 1))
    return float(np.exp(middle - half)), min(1.0, float(np.exp(middle + half)))
