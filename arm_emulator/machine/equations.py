"""A machine's equations about a state, as the core has them (core/mechanics/linearisation.hpp)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from arm_emulator.base.by_value import ByValue
from arm_emulator.machine.chain import Array


@dataclass(frozen=True, eq=False)
class Equations(ByValue):
    """D dz/dt = f(z, q, v, u) and dv/dt = a(z, q, v, u), with what each joint does held.

    Rows and columns are as in ``arm_linearise``: a drive may have fewer than K states.

    Attributes:
        x: z, q and v, ((K + 2) N,).
        u: commands (N,).
        states: places in x of the states of the drives, drive by drive.
        D: (K N,), 0 of what follows at once.
        by: derivatives of f, a, the motors' currents and their angles by x and u.
        value: those themselves, ((K + 3) N,).
        sticks: links that stick (N,).
    """

    x: Array
    u: Array
    states: NDArray[np.int64]
    D: Array
    by: Array
    value: Array
    sticks: NDArray[np.bool_]

    @classmethod
    def of(cls, x: Array, u: Array, numbers: Array) -> Equations:
        """Return what ``arm_linearise`` has written."""
        N = len(u)
        K, rows = len(x) // N - 2, len(x) + N
        table, D = numbers[: rows * (rows + 1)].reshape(rows, rows + 1), numbers[-(K + 2) * N :]
        sticks, counts = D[K * N :].reshape(2, N)
        states = [k * N + j for j in range(N) for k in range(int(counts[j]))]
        there = np.array(states, np.int64)
        return cls(x, u, there, D[: K * N], table[:, :-1], table[:, -1], sticks > 0.0)
