"""Variation in campaigns: distributions, points of a run's index, intervals."""

import math

import numpy as np
import pytest
from scipy import stats

from arm_emulator.base.refusal import Refusal
from arm_emulator_campaign.sampling.distributions import parse_distribution
from arm_emulator_campaign.sampling.variation import Variation, Varying, make_correlation

DISTRIBUTIONS = [
    ("uniform(-1, 3)", stats.uniform(-1, 4)),
    ("loguniform(0.1, 10)", stats.loguniform(0.1, 10)),
    ("normal(2, 0.5)", stats.norm(2, 0.5)),
    ("lognormal(2, 0.4)", stats.lognorm(0.4, scale=2 * math.exp(-0.08))),
    ("triangular(1, 2, 5)", stats.triang(0.25, 1, 4)),
    ("triangular(1, 1, 5)", stats.triang(0, 1, 4)),
    ("triangular(1, 5, 5)", stats.triang(1, 1, 4)),
    ("exponential(3)", stats.expon(scale=3)),
    ("weibull(1.5, 2)", stats.weibull_min(1.5, scale=2)),
    ("beta(2, 3, -1, 1)", stats.beta(2, 3, -1, 2)),
    ("truncated(normal(0, 1), -0.5, 2)", stats.truncnorm(-0.5, 2)),
    ("truncated(exponential(1), 0.5, 1)", stats.truncexpon(0.5, 0.5)),
    ("truncated(triangular(0, 1, 2), 0, 2)", stats.triang(0.5, 0, 2)),
]


@pytest.mark.parametrize(("text", "truth"), DISTRIBUTIONS)
def test_quantiles_are_those_of_scipy(text, truth):
    distribution = parse_distribution(text, "c", "x")
    for u in (1e-9, 0.01, 0.3, 0.5, 0.77, 0.999, 1 - 1e-9):
        assert distribution.evaluate_at(u, math.nan) == pytest.approx(
            truth.ppf(u), rel=1e-9, abs=1e-9
        )
        if distribution.share is not None:
            assert distribution.share(truth.ppf(u)) == pytest.approx(u, abs=1e-9)


@pytest.mark.parametrize(("text", "truth"), DISTRIBUTIONS)
def test_a_part_of_a_distribution_has_values_of_it_alone(text, truth):
    low, high = truth.ppf([1e-3, 0.999])
    for first, last in ((low, high), (low - 9.0, 0.5 * (low + high)), (0.5 * (low + high), 1e3)):
        part = parse_distribution(f"truncated({text}, {float(first)!r}, {float(last)!r})", "c", "x")
        below, above = truth.cdf([first, last])
        for u in (1e-9, 0.3, 0.77, 1 - 1e-9):
            expected = truth.ppf(below + u * (above - below))
            assert part.evaluate_at(u, math.nan) == pytest.approx(expected, rel=1e-7, abs=1e-7)
        assert part.share(-1e9) == 0.0 and part.share(1e9) == 1.0


def test_choices_and_mixtures_have_their_shares():
    u = (np.arange(10_000) + 0.5) / 10_000
    choice = parse_distribution("choice(1, 2, 5)", "c", "x")
    values = [choice.evaluate_at(level, 0.0) for level in u]
    assert [values.count(value) for value in (1.0, 2.0, 5.0)] == [3333, 3334, 3333]
    mixture = parse_distribution("nominal * mixture(3, uniform(0, 1), 1, uniform(9, 10))", "c", "x")
    mixed = np.array([mixture.evaluate_at(level, 2.0) for level in u])
    assert np.count_nonzero(mixed < 3.0) == 7500 and mixed.min() < 1e-3 and mixed.max() > 19.99
    assert parse_distribution(4, "c", "x").evaluate_at(0.3, 0.0) == 4.0


def variation(sampling, count, numbers=3, pairs=(), text="uniform(0, 1)"):
    of = [Varying(f"x{k}", "", parse_distribution(text, "c", "x"), 1.0) for k in range(numbers)]
    return Variation(of, sampling, bytes(range(32)), count, make_correlation(pairs, of, "c"), "c")


def cube(of, count):
    return of.draw_values(np.arange(count))[0]


@pytest.mark.parametrize("sampling", ["random", "sobol", "latin"])
def test_points_are_functions_of_their_index(sampling):
    points = cube(variation(sampling, 64), 64)
    repeated = variation(sampling, 64)
    for index in (63, 0, 17, 18, 5, 5):
        assert np.array_equal(repeated.draw_values(np.array([index]))[0][0], points[index])
    assert len(np.unique(points)) == points.size
    discrepancy = stats.qmc.discrepancy(points)
    assert discrepancy < {"random": 0.1, "sobol": 0.0012, "latin": 0.01}[sampling]
    strata = np.sort((points * 64).astype(int), axis=0)
    assert (strata == np.arange(64)[:, None]).all() == (sampling != "random")


def test_correlation_and_grids():
    points = cube(variation("random", 1, pairs=[(["x0", "x2"], 0.8)]), 4000)
    # Of the normal scores: 0.8; 4000 points know it to 0.36 / 63 = 0.006, five times that is a slip
    correlations = np.corrcoef(stats.norm.ppf(points).T)
    assert correlations[0, 2] == pytest.approx(0.8, abs=0.03) and abs(correlations[0, 1]) < 0.08
    with pytest.raises(Refusal, match="hold together"):
        pairs = [(["x0", "x1"], 0.9), (["x1", "x2"], 0.9), (["x0", "x2"], -0.9)]
        variation("random", 1, pairs=pairs)
    grid = variation("random", 1, 2, text="grid(-1, 1, 5)")
    assert grid.levels == 25
    assert len({tuple(row) for row in cube(grid, 25).tolist()}) == 25
    assert (cube(grid, 50)[25:] == cube(grid, 25)).all()


def test_numbers_may_follow_from_a_common_number():
    for pairs, signs in (
        ([(["x0", "x1", "x2"], 1.0)], (1, 1)),
        ([(["x0", "x1"], -1.0), (["x1", "x2"], -1.0), (["x0", "x2"], 1.0)], (-1, 1)),
    ):
        score = stats.norm.ppf(cube(variation("random", 1, pairs=pairs), 50))
        for place, sign in enumerate(signs, 1):
            assert score[:, place] == pytest.approx(sign * score[:, 0], abs=1e-12)
    with pytest.raises(Refusal, match="hold together"):
        variation("random", 1, pairs=[(["x0", "x1"], 1.0), (["x1", "x2"], 0.5)])
