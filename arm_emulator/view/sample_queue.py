"""A bounded queue of samples that costs its writer next to nothing."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Times = NDArray[np.int64]


class SampleQueue:
    """Samples of `width` quantities for `joints` joints, from one writer to one reader.

    `put` never blocks, never raises and only copies the arrays. The reader converts them
    to rows and finds invalid ones. When the reader has fallen behind by `capacity` samples, new
    ones are dropped.

    Attributes:
        dropped: samples that found no room, or were invalid.
        newest: time of the last sample taken in [ns].
    """

    def __init__(self, capacity: int, width: int, joints: int) -> None:
        self.dropped = 0
        self.newest = 0
        self._capacity = capacity
        self._shape = (width, joints)
        # Appending and popping are safe between threads.
        self._samples: deque[tuple[int, list[Array]]] = deque()

    def __len__(self) -> int:
        return len(self._samples)

    def put(self, time: int, quantities: Sequence[Array]) -> None:
        """Append one sample: its time [ns] and, per quantity, (joints,) values."""
        if len(self._samples) >= self._capacity:
            self.dropped += 1
            return
        try:
            self._samples.append((time, [values.copy() for values in quantities]))
        except Exception:  # numbers without `copy`, or no quantities at all
            self.dropped += 1
            return
        self.newest = time

    def take(self, limit: int) -> tuple[Times, Array]:
        """Remove and return up to `limit` oldest samples: times (K,) [ns], rows (K, width, N)."""
        count = min(len(self._samples), limit)
        return self._stack([self._samples.popleft() for _ in range(count)])

    def _stack(self, samples: list[tuple[int, list[Array]]]) -> tuple[Times, Array]:
        try:
            times = np.array([time for time, _ in samples], np.int64)
            rows = np.array([quantities for _, quantities in samples], np.float64)
            if times.ndim == 1 and rows.shape == (len(samples), *self._shape):
                return times, rows
        except (TypeError, ValueError, OverflowError):
            pass
        if len(samples) > 1:  # leave out those that are at fault
            parts = [self._stack([sample]) for sample in samples]
            return np.concatenate([t for t, _ in parts]), np.concatenate([r for _, r in parts])
        self.dropped += len(samples)
        return np.empty(0, np.int64), np.empty((0, *self._shape))
