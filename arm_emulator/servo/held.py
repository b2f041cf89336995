"""Linear systems whose inputs are held over a period, exactly."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from arm_emulator.base.products import product

FloatArray = npt.NDArray[np.float64]

_TERMS = 14  # of the series; of a matrix of size 1/2 the rest is below 1e-16


def held(A: FloatArray, B: FloatArray, period: float) -> tuple[FloatArray, FloatArray]:
    """Return F and G such that dx/dt = A x + B u, u held, leads to x(T) = F x(0) + G u.

    Args:
        A: (n, n) [1/s].
        B: (n, m).
        period: T [s].
    """
    n, m = B.shape
    whole = np.zeros((n + m, n + m))
    whole[:n, :n], whole[:n, n:] = A, B
    out = exponential(whole * period)
    return out[:n, :n], out[:n, n:]


def exponential(A: FloatArray) -> FloatArray:
    """Return exp(A): a series of A / 2**n, and n squarings (Moler and Van Loan 2003, method 3).

    Raises:
        OverflowError: it has numbers beyond those of a computer.
    """
    with np.errstate(all="ignore"):
        out = _exponential(A)
    if not np.isfinite(out).all():
        raise OverflowError("the exponential of a matrix is too large")
    return out


def _exponential(A: FloatArray) -> FloatArray:
    size = float(np.abs(A).sum(axis=1).max())
    squarings = max(0, int(np.frexp(size)[1]) + 1)
    step = A / 2.0**squarings
    term = out = np.eye(len(A))
    for k in range(1, _TERMS):
        term = product(term, step) / k
        out = out + term
    for _ in range(squarings):
        out = product(out, out)
    return out
