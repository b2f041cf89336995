"""Intervals of campaigns have the true value as often as they state, for few runs and many."""

import math

import numpy as np
import pytest
from draws import FULL, with_slow
from numpy.typing import NDArray
from scipy import stats

from arm_emulator_campaign.definition.campaign import Stop
from arm_emulator_campaign.execution.executor import FIRST_STAGE, GROWTH
from arm_emulator_campaign.results.summary import QUANTILES, Quantile
from arm_emulator_campaign.sampling.intervals import (
    bound_mean,
    bound_quantile,
    bound_share,
)

CAMPAIGNS = 2000
COUNTS = (20, 50, 100, 300, 1000, 10_000)


def error_of(share: float, count: int) -> float:
    """4 deviations of a share, which one of 30 000 shares exceeds."""
    return 4.0 * math.sqrt(share * (1.0 - share) / count)


def test_intervals_of_shares_cover_as_they_state() -> None:
    # Coverage summed over all outcomes.
    for share in (0.02, 0.2, 0.5):
        chance = stats.binom.pmf(range(41), 40, share)
        ends = [bound_share(k, 40, 0.9) for k in range(41)]
        holds = sum(p for p, (a, b) in zip(chance, ends, strict=True) if a <= share <= b)
        assert holds >= 0.9


@pytest.mark.parametrize("count", [*range(1, 60), *COUNTS])
def test_intervals_of_quantiles_cover_as_they_state(count: int) -> None:
    """The k-th smallest of uniform numbers has a beta distribution: coverage in closed form."""
    for q in QUANTILES:
        for confidence in (0.9, 0.95, 0.99):
            low, high = bound_quantile(q, count, confidence)
            above = 0.0 if low is None else stats.beta.sf(q, low + 1, count - low)
            below = 0.0 if high is None else stats.beta.cdf(q, high + 1, count - high)
            assert above + below <= 1.0 - confidence + 1e-12, (q, confidence)
            # No end is further out than it must be.
            tail = (1.0 - confidence) * (1.0 if low is None or high is None else 0.5)
            if low is not None and low + 1 < count:
                assert stats.beta.sf(q, low + 2, count - low - 1) > tail
            if high is not None and high > 0:
                assert stats.beta.cdf(q, high, count - high + 1) > tail


def test_places_are_those_of_tables() -> None:
    # Tables of the sign test name the 40th and the 61st of 100 numbers.
    assert bound_quantile(0.5, 100, 0.95) == (39, 60)
    assert bound_quantile(0.99, 100, 0.95)[1] is None
    assert bound_quantile(0.01, 100, 0.95)[0] is None
    assert bound_quantile(0.5, 1, 0.95) == (None, None)


@pytest.mark.parametrize("count", COUNTS)
def test_quantiles_of_simulated_campaigns(count: int) -> None:
    rng = np.random.default_rng(count)
    campaigns = CAMPAIGNS if FULL or count < 1000 else 400
    values = np.sort(rng.exponential(size=(campaigns, count)), axis=1)
    for q in QUANTILES:
        low, high = bound_quantile(q, count, 0.95)
        truth = -math.log1p(-q)
        above = np.zeros(campaigns) if low is None else values[:, low] > truth
        below = np.zeros(campaigns) if high is None else values[:, high] < truth
        missed = float(np.mean(above) + np.mean(below))
        assert missed <= 0.05 + error_of(0.05, campaigns), (q, low, high)


@pytest.mark.parametrize("count", COUNTS)
def test_shares_of_simulated_campaigns(count: int) -> None:
    rng = np.random.default_rng(count)
    for share in (1e-3, 0.01, 0.1, 0.5):
        hits = rng.binomial(count, share, CAMPAIGNS)
        ends = {k: bound_share(int(k), count, 0.95) for k in np.unique(hits)}
        holds = np.mean([ends[k][0] <= share <= ends[k][1] for k in hits])
        assert holds >= 0.95 - error_of(0.05, CAMPAIGNS)


@pytest.mark.parametrize(
    ("confidence", "width", "share"),
    [(0.9, 0.05, 0.2044), (0.9, 0.01, 0.01), (0.95, 0.02, 0.02031), (0.99, 0.01, 0.05878)],
)
def test_a_campaign_that_ends_by_the_width_of_its_intervals_covers_as_it_states(
    confidence: float, width: float, share: float
) -> None:
    """At shares where looking several times costs most: 87.6 % of 90 without the correction."""
    rng, stop = np.random.default_rng(1), Stop(width, confidence, 0.0)
    campaigns = 20_000 if FULL else CAMPAIGNS
    hits, running = np.zeros(campaigns, np.int64), np.ones(campaigns, bool)
    count, before, covered = FIRST_STAGE, 0, 0
    while running.any():
        hits[running] += rng.binomial(count - before, share, np.count_nonzero(running))
        for k in np.unique(hits[running]):
            low, high = stop.compute_interval(int(k), count)
            if high - low <= width:
                ended = running & (hits == k)
                covered += np.count_nonzero(ended) if low <= share <= high else 0
                running &= ~ended
        before, count = count, math.ceil(GROWTH * count)
    assert covered / campaigns >= confidence - error_of(confidence, campaigns)


def lognormal(rng: np.random.Generator, deviation: float, zeros: float) -> NDArray[np.float64]:
    """Ten estimates with a mean of 1e-6, as repetitions of a search have them."""
    p = 1e-6 / (1.0 - zeros) * rng.lognormal(-0.5 * deviation**2, deviation, 10)
    return p * (rng.random(10) >= zeros)


@pytest.mark.parametrize(
    ("deviation", "zeros"),
    # Estimates that are 0 at times are products of small shares, which scatter.
    with_slow(
        [(0.1, 0.0), (0.5, 0.0), (1.0, 0.0), (2.0, 0.0), (1.5, 0.1), (1.5, 0.45), (2.0, 0.65)], 5
    ),
)
def test_intervals_of_repetitions_cover_as_they_state(deviation: float, zeros: float) -> None:
    rng, cases = np.random.default_rng(1), CAMPAIGNS if FULL else 150
    covered = []
    for _ in range(cases):
        low, high = bound_mean(lognormal(rng, deviation, zeros), 0.95)
        covered.append(low <= 1e-6 <= high)
    # Above, too, or intervals without ends would pass; zeros alone are known less well.
    assert 0.95 - error_of(0.95, cases) <= np.mean(covered) <= 0.99


def test_words_of_open_intervals() -> None:
    words = [
        Quantile("c", 0.5, 2.0, *ends).interval
        for ends in ((1.0, 3.0), (1.0, math.inf), (-math.inf, 3.0), (-math.inf, math.inf))
    ]
    assert words == ["1 to 3", "above 1", "below 3", "too few runs for an interval"]
