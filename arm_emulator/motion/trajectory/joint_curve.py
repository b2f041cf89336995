"""Curves of the joints, without time."""

import bisect
import functools
import math
from typing import Self

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.motion.model.arm_tree import PATH_HEADER, path_library
from arm_emulator.toolchain.c_header import CData, make_pointer

DERIVATIVES = 4  # the curve itself among them
ROUNDING = 1e-9  # rad or m beyond a limit, or beyond the begin of a curve that begins outside


@functools.cache
def _derive_powers(degrees: int) -> tuple[Array, Array]:
    """Return factors and exponents of powers in their derivatives, (DERIVATIVES, degrees) each."""
    orders, powers = range(DERIVATIVES), range(degrees)
    factors = [[float(math.perm(d, order)) for d in powers] for order in orders]
    return np.array(factors), np.array([[max(0, d - order) for d in powers] for order in orders])


class JointCurve:
    """Joint coordinates over s in [0, 1], polynomials piece by piece.

    Args:
        breaks: where pieces begin, and 1 (K + 1,), ascending from 0.
        coefficients: of each piece, in powers of the distance from its begin, (K, D, N).
    """

    def __init__(self, breaks: Array, coefficients: Array) -> None:
        self.breaks, self.coefficients = breaks, np.ascontiguousarray(coefficients)
        self._breaks: list[float] = breaks[1:-1].tolist()
        self._factors, self._powers = _derive_powers(coefficients.shape[1])

    @classmethod
    def make_line(cls, start: Array, end: Array) -> Self:
        """Return the straight line between two configurations (N,)."""
        return cls(np.array([0.0, 1.0]), np.stack([start, end - start])[None])

    @classmethod
    def fit_spline(cls, nodes: Array) -> Self:
        """Return the cubic spline through configurations (K + 1, N), evenly spread over s."""
        y = np.ascontiguousarray(nodes)
        count, columns = y.shape
        h = 1.0 / (count - 1)
        m = np.empty_like(y)
        path_library().path_spline(count, columns, h, make_pointer(y), make_pointer(m))
        slope = np.diff(y, axis=0) / h - h / 6.0 * (2.0 * m[:-1] + m[1:])
        rise = np.diff(m, axis=0) / (6.0 * h)
        coefficients = np.stack([y[:-1], slope, 0.5 * m[:-1], rise], axis=1)
        return cls(np.arange(count) * h, coefficients)

    @property
    def struct(self) -> CData:
        """The curve as path.h takes it, which must not outlive it."""
        pieces, degrees, columns = self.coefficients.shape
        return PATH_HEADER.make_struct(
            "path_curve",
            pieces=pieces,
            degrees=degrees,
            columns=columns,
            breaks=self.breaks,
            coefficients=self.coefficients,
        )

    @property
    def end(self) -> Array:
        """Joint angles at s = 1 (N,)."""
        return np.asarray(self.compute_derivatives(np.ones(1))[0, 0])

    def find_exit(self, low: Array, high: Array) -> tuple[float, int, float] | None:
        """Return place, joint and angle where it leaves a range (N,) first; None: nowhere."""
        low = np.minimum(low, self.coefficients[0, 0]) - ROUNDING
        high = np.maximum(high, self.coefficients[0, 0]) + ROUNDING
        lengths = np.diff(self.breaks)
        at, changes = self.coefficients[:, 0], np.zeros_like(self.coefficients[:, 0])
        for row in np.abs(self.coefficients[:, :0:-1]).swapaxes(0, 1):
            changes = (changes + row) * lengths[:, None]  # at most, from the begin of a piece
        if (at - changes >= low).all() and (at + changes <= high).all():
            return None
        excess = find_excess(self.coefficients, lengths, 0, low, high)
        return None if excess is None else (float(self.breaks[excess[0]]), *excess[1:])

    def compute_derivatives(self, s: Array) -> Array:
        """Return q and its first three derivatives at places (K,), (4, K, N)."""
        piece = np.searchsorted(self._breaks, s, side="right")
        powers = np.vander(s - self.breaks[piece], self._factors.shape[1], increasing=True)
        weights = self._factors * powers[:, self._powers]
        return np.asarray(np.swapaxes(weights @ self.coefficients[piece], 0, 1))

    def derive_by_time(self, s: float, d1: float, d2: float, d3: float) -> Array:
        """Return q and its first three derivatives by time, (4, N), from those of s."""
        piece = bisect.bisect_right(self._breaks, s)
        x = s - float(self.breaks[piece])
        coefficients = self.coefficients[piece]
        by_s = []
        for order in range(DERIVATIVES):
            power, row = 1.0, [0.0] * order
            for d in range(order, len(coefficients)):
                row.append(math.perm(d, order) * power)
                power *= x
            by_s.append(row[: len(coefficients)])
        q, q1, q2, q3 = by_s
        weights = [
            q,
            [d1 * by_1 for by_1 in q1],
            [d2 * by_1 + d1 * d1 * by_2 for by_1, by_2 in zip(q1, q2, strict=True)],
            [
                d3 * by_1 + 3.0 * d1 * d2 * by_2 + d1**3 * by_3
                for by_1, by_2, by_3 in zip(q1, q2, q3, strict=True)
            ],
        ]
        return np.asarray(np.array(weights) @ coefficients)


def find_excess(
    pieces: Array, lengths: Array, order: int, low: Array, high: Array
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
    hull = np.einsum("ik,skm->sim", _compute_bernstein(degree), c)
    for piece, column in np.argwhere((hull.min(axis=1) < low) | (hull.max(axis=1) > high)):
        poly = np.polynomial.Polynomial(c[piece, :, column])
        extremes = np.clip(poly.deriv().trim().roots().real, 0.0, 1.0)
        values = poly(np.concatenate([[0.0, 1.0], extremes]))
        for value in (float(values.min()), float(values.max())):
            if not low[column] <= value <= high[column]:
                return int(piece), int(column), value
    return None


def _compute_bernstein(degree: int) -> Array:
    """Return the weights that make Bernstein coefficients (rows) from those of powers."""
    rows = range(degree + 1)
    return np.array(
        [[math.comb(i, k) / math.comb(degree, k) if k <= i else 0.0 for k in rows] for i in rows]
    )
