"""Reading a work-precision curve at a given error."""

from __future__ import annotations

import math
from typing import Any


def time_at_error(points: list[dict[str, Any]], target: float) -> float | None:
    """Return the wall time [s] at which a series' error falls to `target`, None if it never does.

    Interpolated on the logarithms of error and time. Where the coarsest step is better than that
    already, its time: there is nothing cheaper.
    """
    before = None
    for point in points:
        if point["error"] is None:
            before = None
            continue
        time = point["time"]["median"]
        if point["error"] <= target:
            if before is None:
                return float(time)
            (e0, t0), (e1, t1) = before, (max(point["error"], 1e-300), time)
            share = math.log(e0 / target) / math.log(e0 / e1)
            return float(math.exp(math.log(t0) + share * math.log(t1 / t0)))
        before = point["error"], time
    return None
