"""Polynomials, piece by piece: whether they leave a range, between their ends, too."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def beyond(
    pieces: FloatArray, lengths: FloatArray, order: int, low: FloatArray, high: FloatArray
) -> tuple[int, int, float] | None:
    """Return piece, column and value where a derivative leaves its range first; None: nowhere.

    A polynomial stays within its Bernstein coefficients; only where these leave the range are its
    extremes looked for.

    Args:
        pieces: coefficients in powers of the distance from the begin of each piece, (S, D, M).
        lengths: of the pieces (S,).
        order: of the derivative, 0 or 1.
        low: least values (M,).
        high: largest values (M,).
    """
    degree = pieces.shape[1] - 1
    c = pieces * lengths[:, None, None] ** np.arange(degree + 1)[:, None]  # from 0 to 1
    if order == 1:
        c = np.concatenate([c[:, 1:] * np.arange(1, degree + 1)[:, None], 0.0 * c[:, :1]], axis=1)
        c /= lengths[:, None, None]
    hull = np.einsum("ik,skm->sim", _bernstein(degree), c)
    for piece, column in np.argwhere((hull.min(axis=1) < low) | (hull.max(axis=1) > high)):
        poly = np.polynomial.Polynomial(c[piece, :, column])
        turns = np.clip(poly.deriv().trim().roots().real, 0.0, 1.0)
        values = poly(np.concatenate([[0.0, 1.0], turns]))
        for value in (float(values.min()), float(values.max())):
            if not low[column] <= value <= high[column]:
                return int(piece), int(column), value
    return None


def _bernstein(degree: int) -> FloatArray:
    """Return the weights that make Bernstein coefficients (rows) from those of powers."""
    rows = range(degree + 1)
    return np.array(
        [[math.comb(i, k) / math.comb(degree, k) if k <= i else 0.0 for k in rows] for i in rows]
    )
