"""Results of a campaign: shares of failures, and quantiles of all numbers of its runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.results.parts import FAILED, INDEX, MEASURE, ROBUSTNESS
from arm_emulator_campaign.sampling.intervals import bound_quantile

QUANTILES = (0.01, 0.05, 0.5, 0.95, 0.99)
ANY = "any requirement"


@dataclass(frozen=True)
class FailureRate:
    """Rate of failures of a requirement.

    Attributes:
        name: of the requirement.
        hits: runs in which it fails.
        share: of all runs.
        low, high: confidence interval of the share, see `Stop.compute_interval`.
        worst: index of the run with the least robustness; -1: none.
        least: that robustness.
    """

    name: str
    hits: int
    share: float
    low: float
    high: float
    worst: int
    least: float


@dataclass(frozen=True)
class Quantile:
    """A quantile of a column, with its confidence interval.

    An end that so few runs do not have is -inf or inf, see `bound_quantile`.
    """

    column: str
    q: float
    value: float
    low: float
    high: float

    @property
    def interval(self) -> str:
        """The interval in words."""
        if math.isinf(self.low) and math.isinf(self.high):
            return "too few runs for an interval"
        if math.isinf(self.high):
            return f"above {self.low:.5g}"
        if math.isinf(self.low):
            return f"below {self.high:.5g}"
        return f"{self.low:.5g} to {self.high:.5g}"


@dataclass(frozen=True)
class Summary:
    """Results of a campaign.

    Attributes:
        count: of runs.
        confidence: of all intervals.
        shares: of each requirement, and of any last.
        quantiles: of robustness and measures.
    """

    count: int
    confidence: float
    shares: tuple[FailureRate, ...]
    quantiles: tuple[Quantile, ...]


def compute_summary(campaign: Campaign, columns: Mapping[str, NDArray[Any]]) -> Summary:
    """Return the summary of a campaign's rows."""
    count, confidence = len(columns[INDEX]), campaign.stop.confidence
    shares = []
    for name in (*campaign.requirements, ANY):
        values = columns.get(f"{ROBUSTNESS}{name}", np.zeros(0))
        failed = columns[FAILED] if name == ANY else ~(values >= 0.0)
        hits = int(np.count_nonzero(failed))
        low, high = campaign.stop.compute_interval(hits, count)
        at = int(np.argmin(values)) if len(values) else -1
        worst = int(columns[INDEX][at]) if at >= 0 else -1
        margin = float(values[at]) if at >= 0 else float("nan")
        share = hits / count if count else float("nan")
        shares.append(FailureRate(name, hits, share, low, high, worst, margin))
    names = [f"{ROBUSTNESS}{name}" for name in campaign.requirements]
    names += [f"{MEASURE}{name}" for name in campaign.measures]
    quantiles = [
        quantile for name in names for quantile in _find_quantiles(name, columns[name], confidence)
    ]
    return Summary(count, confidence, tuple(shares), tuple(quantiles))


def _find_quantiles(name: str, values: NDArray[Any], confidence: float) -> list[Quantile]:
    ordered = np.sort(values[~np.isnan(values)])
    if not len(ordered):
        return []
    quantiles = []
    for q in QUANTILES:
        at = min(len(ordered) - 1, int(q * len(ordered)))
        low, high = bound_quantile(q, len(ordered), confidence)
        ends = (
            -math.inf if low is None else ordered[low],
            math.inf if high is None else ordered[high],
        )
        quantiles.append(Quantile(name, q, *map(float, (ordered[at], *ends))))
    return quantiles
