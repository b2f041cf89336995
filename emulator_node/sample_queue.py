"""A bounded queue of samples that costs its writer next to nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


class SampleQueue:
    """Samples of `width` quantities for `joints` joints, from one writer to one reader.

    `put` never blocks, never raises and copies into memory that is there already. When the reader
    has fallen behind by `capacity` samples, new ones are dropped and counted in `dropped`. No lock
    is needed: only the writer moves `_written`, only the reader moves `_read`, each of them after
    it is done with the memory.

    Attributes:
        dropped: samples that found no place, or were none.
        newest: time of the last sample taken in [ns].
    """

    def __init__(self, capacity: int, width: int, joints: int) -> None:
        self.capacity = capacity
        self.dropped = 0
        self.newest = 0
        self._times = np.zeros(capacity, np.int64)
        self._rows = np.zeros((capacity, width, joints))
        self._written = 0
        self._read = 0

    def put(self, time: int, *quantities: ArrayLike | None) -> None:
        """Append one sample: its time [ns] and, per quantity, (joints,) values; None is NaN."""
        written = self._written
        if written - self._read >= self.capacity:
            self.dropped += 1
            return
        slot = written % self.capacity
        row = self._rows[slot]
        try:
            self._times[slot] = time
            for index, values in enumerate(quantities):
                row[index] = np.nan if values is None else values
        except (TypeError, ValueError, IndexError, OverflowError):
            self.dropped += 1
            return
        self.newest = time
        self._written = written + 1

    def __len__(self) -> int:
        return self._written - self._read

    def take(self, limit: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Remove and return up to `limit` oldest samples: times (K,) [ns], rows (K, width, N)."""
        first = self._read % self.capacity
        # A piece ends where the memory ends: the next call goes on from its start.
        count = min(len(self), limit, self.capacity - first)
        times = self._times[first : first + count].copy()
        rows = self._rows[first : first + count].copy()
        self._read += count
        return times, rows
