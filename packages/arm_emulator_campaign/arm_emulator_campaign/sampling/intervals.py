"""Confidence intervals of shares, of quantiles, and of means of repeated estimates."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import special


def bound_share(hits: int, count: int, confidence: float) -> tuple[float, float]:
    """Return the interval that holds the true share at least that often, whatever it is."""
    if count == 0:
        return 0.0, 1.0
    tail = 0.5 * (1.0 - confidence)
    low = 0.0 if hits == 0 else float(special.betaincinv(hits, count - hits + 1, tail))
    high = 1.0 if hits == count else float(special.betaincinv(hits + 1, count - hits, 1.0 - tail))
    return low, high


def bound_quantile(q: float, count: int, confidence: float) -> tuple[int | None, int | None]:
    """Return the places in a sorted sample between which a quantile lies at least that often.

    The interval is that of order statistics, whatever the distribution (David and Nagaraja, Order
    Statistics, 2003, section 7.1). A sample may be too small for an end: no run of 100 lies above
    the quantile at 0.99 in 37 % of all samples. Such an end is open, None, and the other end has
    all of the remaining probability.
    """
    below = special.bdtr(np.arange(count + 1), count, q)  # of at most so many smaller ones
    alpha = 1.0 - confidence
    low, high = _find_low_place(below, 0.5 * alpha), _find_high_place(below, 0.5 * alpha)
    if high is None and low is not None:
        low = _find_low_place(below, alpha)
    if low is None and high is not None:
        high = _find_high_place(below, alpha)
    return low, high


def _find_low_place(below: NDArray[np.float64], tail: float) -> int | None:
    """Return the last place whose value is above the quantile at most so often."""
    place = int(np.searchsorted(below, tail, "right")) - 1
    return place if place >= 0 else None


def _find_high_place(below: NDArray[np.float64], tail: float) -> int | None:
    """Return the first place whose value is below the quantile at most so often."""
    place = int(np.searchsorted(below, 1.0 - tail))
    return place if place < len(below) - 1 else None


def bound_mean(p: NDArray[np.float64], confidence: float) -> tuple[float, float]:
    """Return the interval of the mean of independent estimates of a probability (K,).

    Estimates that are not 0 are taken to be lognormal, as products of many shares are. Their
    interval is that of generalised pivots (Krishnamoorthy and Mathew, Journal of Statistical
    Planning and Inference 115, 2003). That of the share of zeros is Tian's (Statistics in Medicine
    24, 2005). With fewer than two estimates that are not 0 the interval is 0 to 1.
    """
    logs = np.log(p[p > 0.0])
    n, zeros = len(logs), int(np.count_nonzero(p == 0.0))
    if n < 2:
        return 0.0, 1.0
    scores = np.linspace(-8.0, 8.0, 101)  # of a pivot: sums over them converge fast
    weights = np.exp(-0.5 * scores * scores)
    weights /= np.sum(weights)
    squares = 2.0 * special.gammaincinv(0.5 * (n - 1), special.ndtr(scores))
    variance = np.maximum(float(np.sum((logs - np.mean(logs)) ** 2)) / squares, 1e-30)
    centre, width = np.mean(logs) + 0.5 * variance, np.sqrt(variance / n)
    shift = np.zeros(1)
    if zeros:  # the logarithm of the share that is not 0
        shift = np.log(special.betaincinv(n + 0.5, zeros + 0.5, special.ndtr(scores)))

    def compute_probability(x: float) -> float:
        """Return the pivot's distribution function."""
        inner = special.ndtr((x - shift[:, None] - centre) / width) @ weights
        return float(inner @ weights) if zeros else float(inner[0])

    tail = 0.5 * (1.0 - confidence)
    return _invert_pivot(compute_probability, tail), _invert_pivot(compute_probability, 1.0 - tail)


def _invert_pivot(below: Callable[[float], float], share: float) -> float:
    """Return exp(x) where a distribution function reaches a share; 1 where x is above 0."""
    low, high = -745.0, 0.0  # between the least double and 1
    if below(high) <= share:
        return 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if below(middle) < share else (low, middle)
    return math.exp(high)
