"""The benchmark's headline figures are read off its curves rightly."""

import math

import pytest

from bench.speed.work_precision import find_time_at_error


def points(*pairs):
    return [{"error": error, "time": {"median": time}} for error, time in pairs]


def test_a_power_law_is_read_exactly():
    # error = c h, time = d / h: time = c d / error, a straight line on logarithmic scales.
    curve = points(*((3.0 * h, 1e-6 / h) for h in (1e-3, 1e-4, 1e-5)))
    # 1e-12: rounding of a few logarithms.
    assert find_time_at_error(curve, 7e-4) == pytest.approx(3e-6 / 7e-4, rel=1e-12)
    assert find_time_at_error(curve, 7e-5) == pytest.approx(3e-6 / 7e-5, rel=1e-12)


def test_the_coarsest_step_is_enough_where_it_is_better():
    assert find_time_at_error(points((1e-5, 0.1), (1e-6, 1.0)), 1e-4) == 0.1


def test_an_error_out_of_reach_has_no_time():
    assert find_time_at_error(points((1e-3, 0.1), (1e-4, 1.0)), 1e-5) is None
    assert find_time_at_error(points((None, 0.1)), 1e-5) is None


def test_nothing_is_interpolated_from_a_run_that_diverged():
    assert find_time_at_error(points((None, 0.01), (1e-6, 1.0)), 1e-4) == 1.0


def test_the_first_crossing_counts_where_rounding_brings_the_error_back_up():
    curve = points((1e-2, 1.0), (1e-4, 4.0), (1e-3, 9.0), (1e-5, 16.0))
    assert find_time_at_error(curve, 1e-3) == pytest.approx(math.sqrt(1.0 * 4.0), rel=1e-12)
