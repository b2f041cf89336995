"""Rows of a running machine: the newest ones, and the whole run thinned, in bounded memory."""

from __future__ import annotations

import numpy as np

from arm_emulator.base.column import Rows

NEWEST = 8000  # rows that are kept one by one
MOST = 4000  # rows of the whole run


class LiveHistory:
    """Rows of a run so far.

    When a machine begins anew at an earlier tick, its rows replace those before.

    Attributes:
        count: of rows that have come.

    Args:
        kind: of a row.
    """

    def __init__(self, kind: np.dtype[np.void]) -> None:
        self._newest = np.zeros(0, kind)
        self._whole = np.zeros(0, kind)
        self._every = 1  # of the rows of the whole run
        self.count = 0

    def add(self, rows: Rows) -> None:
        """Add rows (K,) in the order of their ticks."""
        back = np.flatnonzero(np.diff(rows["tick"]) < 0)
        if len(back):
            rows = rows[back[-1] + 1 :]
            self._forget()
        elif len(rows) and len(self._newest) and rows["tick"][0] < self._newest["tick"][-1]:
            self._forget()
        picked = rows[-self.count % self._every :: self._every]
        self.count += len(rows)
        self._whole = np.concatenate([self._whole, picked])
        while len(self._whole) > MOST:
            self._whole, self._every = self._whole[::2].copy(), 2 * self._every
        self._newest = np.concatenate([self._newest, rows])[-NEWEST:].copy()

    def _forget(self) -> None:
        self._newest, self._whole = self._newest[:0], self._whole[:0]
        self._every, self.count = 1, 0

    @property
    def newest(self) -> Rows:
        """The newest row (1,), or none (0,)."""
        return self._newest[-1:]

    def near(self, tick: int) -> Rows:
        """Return the row (1,) that is nearest to a tick, or none (0,)."""
        first = self._newest["tick"][:1]
        rows = self._newest if len(first) and tick >= first[0] else self._whole
        if not len(rows):
            return rows
        place = int(np.argmin(np.abs(rows["tick"] - tick)))
        return rows[place : place + 1]

    def since(self, seconds: float, most: int) -> Rows:
        """Return at most so many rows of the last seconds; infinity: of the whole run."""
        if not len(self._newest):
            return self._newest
        begin = self._newest["t"][-1] - seconds
        rows = self._newest
        if begin < rows["t"][0]:
            rows = np.concatenate([self._whole[self._whole["t"] < rows["t"][0]], rows])
        rows = rows[np.searchsorted(rows["t"], begin) :]
        every = max(1, -(-len(rows) // most))
        return rows[(len(rows) - 1) % every :: every]
