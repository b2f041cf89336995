"""When a way is where: the timing of least duration within limits, at rest at both ends.

A place s of the way is a function of sigma in [0, 1], `Ramps`, whose slope rises smoothly from 0
and falls to 0 again. So what goes along it evenly in sigma begins and ends at rest, with continuous
accelerations, and the rate c = (dsigma/dt)^2 that remains to be found is an ordinary function:
the quadratic spline of cpp/way.h.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass

import numpy as np

from arm_emulator.base.given import FloatArray
from arm_emulator.build.c_header import pointer
from arm_emulator.motion.way_library import way_library

POINTS = (0.0, 0.5, 1.0)  # of a piece, at which way.h asks for the limits
_BESIDE = 1e-9  # of a piece: an end belongs to the piece that it is asked for
_GAUSS, _WEIGHTS = np.polynomial.legendre.leggauss(6)
_GAUSS, _WEIGHTS = 0.5 * (_GAUSS + 1.0), 0.5 * _WEIGHTS
_PAIRS = list(zip(_GAUSS.tolist(), _WEIGHTS.tolist(), strict=True))
_GAP = 0.02  # of the shortest duration, that the search leaves


class Ramps:
    """s over sigma, both in [0, 1]: faster over a part `ramp`, evenly, slower over as long a part.

    Args:
        ramp: in (0, 1/2].
    """

    def __init__(self, ramp: float) -> None:
        self.ramp = ramp

    def at(self, sigma: float) -> tuple[float, float, float, float]:
        """Return s and its first three derivatives at one place."""
        r, top = self.ramp, 1.0 / (1.0 - self.ramp)
        falling = sigma > 0.5
        x = (1.0 - sigma if falling else sigma) / r
        if x >= 1.0:
            s, s1, s2, s3 = top * r * (x - 0.5), top, 0.0, 0.0
        else:
            s, s1 = top * r * x**3 * (1.0 - 0.5 * x), top * x * x * (3.0 - 2.0 * x)
            s2, s3 = top / r * 6.0 * x * (1.0 - x), top / r**2 * (6.0 - 12.0 * x)
        return (1.0 - s, s1, -s2, s3) if falling else (s, s1, s2, s3)

    def derivatives(self, sigma: FloatArray) -> FloatArray:
        """Return s and its first three derivatives, (4, K)."""
        r, top = self.ramp, 1.0 / (1.0 - self.ramp)
        falling = sigma > 0.5
        x = np.where(falling, 1.0 - sigma, sigma) / r
        up = np.minimum(x, 1.0)
        rising = x < 1.0
        out = np.empty((4, len(sigma)))
        s = top * r * (up**3 - 0.5 * up**4 + (x - up))
        out[0] = np.where(falling, 1.0 - s, s)
        out[1] = top * up * up * (3.0 - 2.0 * up)
        out[2] = np.where(rising, top / r * 6.0 * up * (1.0 - up), 0.0)
        out[3] = np.where(rising, top / r**2 * (6.0 - 12.0 * up), 0.0)
        out[2, falling] *= -1.0
        return out


def places(pieces: int, within: tuple[float, ...] = POINTS) -> FloatArray:
    """Return sigma at places within each of so many equal pieces."""
    inside = np.clip(np.array(within), _BESIDE, 1.0 - _BESIDE)
    return np.asarray(((np.arange(pieces)[:, None] + inside) / pieces).ravel())


@dataclass(frozen=True, eq=False)
class Rows:
    """Limits at places along a way, by the derivatives of c = (dsigma/dt)^2, in parts of them."""

    most: FloatArray
    """Of c, (P,)."""
    firsts: FloatArray
    """|f0 + fc c + fd c'| <= 1, (3, P, F)."""
    thirds: FloatArray
    """|tc c + td c' + te c''| sqrt(c) <= 1, (3, P, G)."""

    def within(self, factors: FloatArray) -> Rows:
        """Return limits of which c may take parts (pieces,) in each piece, 1 or less."""
        k = np.repeat(factors, len(POINTS))
        still, moving = self.firsts[:1], self.firsts[1:]
        firsts = np.concatenate([still, moving / k[:, None]])
        return Rows(self.most * k, firsts, self.thirds / (k**1.5)[:, None])


class Timing:
    """sigma over time.

    Args:
        coefficients: of c, (pieces + 2,).

    Attributes:
        duration: [s].
    """

    def __init__(self, coefficients: FloatArray) -> None:
        self.coefficients = coefficients
        self._pieces = len(coefficients) - 2
        x0, x1, x2 = coefficients[:-2], coefficients[1:-1], coefficients[2:]
        # c = k0 + u (k1 + u k2) in a piece, u from 0 to 1.
        k = np.stack([0.5 * (x0 + x1), x1 - x0, 0.5 * (x0 - 2.0 * x1 + x2)])
        at = k[0] + _GAUSS[:, None] * (k[1] + _GAUSS[:, None] * k[2])
        if not (at > 0.0).all():
            raise ArithmeticError("the timing of a way would stand still")
        spans = _WEIGHTS @ (1.0 / np.sqrt(at)) / self._pieces
        self._times = [0.0, *np.cumsum(spans).tolist()]
        self.duration: float = self._times[-1]
        self._polynomials = k.T.tolist()

    def derivatives(self, time: float) -> tuple[float, float, float, float]:
        """Return sigma and its first three derivatives by time [s]."""
        if time >= self.duration:
            return 1.0, 0.0, 0.0, 0.0
        piece = max(0, bisect.bisect_right(self._times, time) - 1)
        k0, k1, k2 = self._polynomials[piece]
        left = (time - self._times[piece]) * self._pieces
        u = min(1.0, left * math.sqrt(k0))
        for _ in range(8):  # Newton's method: the rate is nearly even in a piece
            gone = u * sum(w / math.sqrt(k0 + g * u * (k1 + g * u * k2)) for g, w in _PAIRS)
            step = (left - gone) * math.sqrt(k0 + u * (k1 + u * k2))
            before, u = u, min(1.0, max(0.0, u + step))
            if abs(u - before) < 1e-12:
                break
        n = self._pieces
        c = k0 + u * (k1 + u * k2)
        rate = math.sqrt(c)
        slope, bend = n * (k1 + 2.0 * u * k2), n * n * 2.0 * k2
        return (piece + u) / n, rate, 0.5 * slope, 0.5 * bend * rate


def least_duration(pieces: int, rows: Rows) -> FloatArray | int:
    """Return the coefficients of c, or the place at which not even rest keeps the limits.

    Args:
        pieces: of c.
        rows: at `places(pieces)`.
    """
    law = way_library()
    firsts, thirds = rows.firsts.shape[2], rows.thirds.shape[2]
    found = np.empty(pieces + 2)
    work = np.empty(law.way_work(pieces, firsts, thirds))
    held = [np.ascontiguousarray(rows.most)]
    held += [np.ascontiguousarray(one) for one in (*rows.firsts, *rows.thirds)]
    most, f0, fc, fd, tc, td, te = map(pointer, held)
    fault: int = law.way_time(
        pieces, most, firsts, f0, fc, fd, thirds, tc, td, te, _GAP, pointer(work), pointer(found)
    )
    return fault if fault >= 0 else found
