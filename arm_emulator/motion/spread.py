"""Points that are evenly spread over a cube, the same ones every time."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def spread(count: int, dimensions: int) -> FloatArray:
    """Return points (count, dimensions) in [0, 1).

    They are an additive sequence with the powers of the generalised golden ratio (Roberts 2018, The
    unreasonable effectiveness of quasirandom sequences).
    """
    ratio = 2.0
    for _ in range(64):  # the root of x^(n+1) = x + 1
        ratio = (1.0 + ratio) ** (1.0 / (dimensions + 1))
    powers = ratio ** -np.arange(1.0, dimensions + 1.0)
    return np.asarray(np.mod(0.5 + np.outer(np.arange(1.0, count + 1.0), powers), 1.0))
