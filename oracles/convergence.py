"""Convergence of eq. (6), from its weight and the servo's step response per motion period."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from arm_emulator.base.arrays import Array

SMALL = 0.02  # of the way: errors below count no more


def predict_errors(weight: float, step_response: npt.ArrayLike, instructions: int) -> Array:
    """Return the error of the tool after each instruction of eq. (6), in parts of its way.

    Let S_m be the part of a target's step that the servo has covered after m motion periods, and
    s_m = S_m - S_(m-1). Let E_k be the error at instruction k, with E_0 = 1. Near the target
    eq. (6) gives the servo ``1 - (1 - w) E_k`` of the way. After instruction k the error is then

        E_k = 1 - sum_(m = 1..k) s_m (1 - (1 - w) E_(k-m))

    A servo that covers the part g of the remaining way in every period has s_m = g (1 - g)^(m-1).
    Its error is ``E_k = (1 - w g)^k``, that of an ideal servo ``(1 - w)^k``.

    Args:
        weight: w, in (0, 1].
        step_response: S_1, S_2, ... (M,); later ones are as the last.
        instructions: K.

    Returns:
        E_1 to E_K, (K,).
    """
    steps = np.asarray(step_response, dtype=float)
    parts = np.zeros(max(instructions, len(steps)))
    parts[: len(steps)] = np.diff(steps, prepend=0.0)
    targets = np.zeros(instructions)
    errors = np.ones(instructions + 1)
    for k in range(instructions):
        targets[k] = 1.0 - (1.0 - weight) * errors[k]
        errors[k + 1] = 1.0 - parts[: k + 1] @ targets[k::-1]
    return errors[1:]


def compute_convergence_factor(errors: npt.ArrayLike) -> float:
    """Return the factor by which an instruction makes the error smaller, in the mean.

    Args:
        errors: in parts of the way after each instruction, (K,). Those after the first one below
            `SMALL` do not count.
    """
    sizes = np.abs(errors)
    small = np.flatnonzero(sizes < SMALL)
    last = int(small[0]) if len(small) else len(sizes) - 1
    return float(sizes[last] ** (1.0 / (last + 1)))
