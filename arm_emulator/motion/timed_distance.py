"""Distance along a path over time, for given positions at given times."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


class TimedDistance:
    """Distance over time: quintics between the places, without acceleration in them.

    Slopes as of Fritsch and Butland (1984), so that it never goes back; 0 at both ends and where
    asked for.

    Args:
        times: ascending (K,) [s].
        distance: never falling (K,) [m].
        stops: whether it rests in each place (K,).
    """

    def __init__(
        self, times: FloatArray, distance: FloatArray, stops: npt.NDArray[np.bool_]
    ) -> None:
        self._t, self._s = times, distance
        h = np.diff(times)
        m = np.diff(distance) / h
        self._v = np.zeros_like(distance)
        with np.errstate(divide="ignore"):
            early, late = 2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]
            self._v[1:-1] = (early + late) / (early / m[:-1] + late / m[1:])
        self._v[stops] = 0.0

    def at(self, t: FloatArray) -> FloatArray:
        """Return the distances at times (P,) [s]."""
        i = np.clip(np.searchsorted(self._t, t, side="right") - 1, 0, len(self._t) - 2)
        h = self._t[i + 1] - self._t[i]
        u = np.clip((t - self._t[i]) / h, 0.0, 1.0)
        v0, v1, d = h * self._v[i], h * self._v[i + 1], self._s[i + 1] - self._s[i]
        third = 10.0 * d - 6.0 * v0 - 4.0 * v1
        fourth = -15.0 * d + 8.0 * v0 + 7.0 * v1
        fifth = 6.0 * d - 3.0 * (v0 + v1)
        return np.asarray(self._s[i] + u * (v0 + u * u * (third + u * (fourth + u * fifth))))
