"""Least squares within a box, by the active-set solver DAQP (Arnstroem et al. 2022)."""

from __future__ import annotations

import daqp
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

_FOUND = 1


def solve_in_box(H: FloatArray, g: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the x within [low, high] that makes ``x' H x / 2 - g' x`` smallest, (N,).

    Args:
        H: symmetric and positive definite, (N, N).
        g: (N,).
        low: lower bounds (N,), finite.
        high: upper bounds (N,), finite, none below its lower one.

    Raises:
        ArithmeticError: the solver fails.
    """
    n = len(g)
    x, _, flag, _ = daqp.solve(
        np.ascontiguousarray(H), -g, np.zeros((0, n)), high, low, np.zeros(n, dtype=np.int32)
    )
    if flag != _FOUND:
        raise ArithmeticError(f"the quadratic program found no solution, exit flag {flag}")
    # The solver keeps bounds within its tolerance only.
    return np.clip(np.asarray(x, dtype=np.float64), low, high)
