"""Convergence of eq. (6): derived, against closed forms and the whole machine."""

from __future__ import annotations

import numpy as np
import pytest

from arm_emulator.base.refusal import Refusal
from bench.convergence import INSTRUCTIONS, measured_factor, step_response
from oracles.convergence import convergence_factor, expected_errors


def test_closed_forms() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        w, g = rng.uniform(0.01, 1.0, 2)
        k = np.arange(1, 60)
        errors = expected_errors(w, 1.0 - (1.0 - g) ** k, len(k))
        assert np.allclose(errors, (1.0 - w * g) ** k, rtol=0, atol=1e-13), (w, g)  # rounding
        assert convergence_factor(errors) == pytest.approx(1.0 - w * g, abs=1e-9)
        always_there = expected_errors(w, [1.0], len(k))
        assert np.allclose(always_there, (1.0 - w) ** k, rtol=0, atol=1e-13)


def test_any_servo_as_reported_step_by_step() -> None:
    """Against the loop itself: a servo of second order that is reported eq. (6) again and again."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        w = rng.uniform(0.05, 1.0)
        A = np.array([[0.0, 1.0], [-rng.uniform(0.05, 0.4), rng.uniform(0.2, 1.2)]])
        b = np.array([0.0, 1.0 - A[1, 1] - A[1, 0]])
        x, response = np.zeros(2), []
        for _ in range(60):
            x = A @ x + b
            response.append(x[0])
        x, errors = np.zeros(2), []
        for _ in range(30):
            x = A @ x + b * (x[0] + w * (1.0 - x[0]))
            errors.append(1.0 - x[0])
        assert np.allclose(expected_errors(w, response, 30), errors, rtol=0, atol=1e-12)


@pytest.mark.parametrize("period", [0.02, 0.05, 0.1])
def test_the_machine_converges_as_predicted(period: float) -> None:
    rng = np.random.default_rng(round(period * 1e3))
    response = step_response(period)
    for w in rng.uniform(0.2, 0.95, 2):
        expected = convergence_factor(expected_errors(w, response, INSTRUCTIONS))
        # Counts of the encoder (1e-3 of the way), limits, and an arm whose Jacobian changes.
        assert measured_factor(w, period) == pytest.approx(expected, abs=0.03), w


def test_numbers_out_of_range_are_refused() -> None:
    for weight, steps in ((0.0, [1.0]), (1.5, [1.0]), (0.5, []), (0.5, [np.nan]), (0.5, 1.0)):
        with pytest.raises(Refusal):
            expected_errors(weight, steps, 3)
    with pytest.raises(Refusal):
        expected_errors(0.5, [1.0], -1)
    with pytest.raises(Refusal):
        convergence_factor([np.nan])
