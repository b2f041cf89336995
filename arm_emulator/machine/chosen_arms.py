"""Some arms of a fleet, as callers name them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_emulator.base.refusal import Refusal


def chosen_arms(where: str, arms: ArrayLike | None, count: int) -> NDArray[np.bool_]:
    """Return which arms are chosen, as a mask (count,).

    Args:
        where: for refusals.
        arms: a mask (count,) or indices; None: all.
        count: of arms.

    Raises:
        Refusal: no such arms.
    """
    if arms is None:
        return np.ones(count, bool)
    try:
        chosen = np.asarray(arms)
    except Exception:  # any error of a foreign object means that it has no numbers
        chosen = np.asarray(None)
    if chosen.dtype == np.bool_ and chosen.shape == (count,):
        return np.ascontiguousarray(chosen)
    mask = np.zeros(count, bool)
    whole = chosen.dtype.kind in "iu" or chosen.size == 0
    if not whole or chosen.ndim > 1 or (np.abs(chosen + 0.5) > count).any():
        raise Refusal(where, "arms", f"be a mask of {count}, or indices of {count} arms", arms)
    mask[chosen.astype(np.int64)] = True
    if mask.sum() < chosen.size:  # such as a mask of 0 and 1
        raise Refusal(where, "arms", f"be a mask of {count}, or indices, each once", arms)
    return mask
