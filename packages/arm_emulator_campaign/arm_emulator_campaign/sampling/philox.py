"""Random numbers as a function of a key and an index: Philox-4x64-10 in arrays.

Salmon, Moraes, Dror and Shaw, Parallel random numbers: as easy as 1, 2, 3, SC11, 2011. They are the
doubles of `numpy.random.Philox` with that key, whose counter's last word is the index.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import Array

Words = NDArray[np.uint64]

ROUNDS = 10
_FACTOR = np.array([0xD2E7470EE14C6C93, 0xCA5A826395121157], np.uint64)[:, None, None]
_WEYL = (0x9E3779B97F4A7C15, 0xBB67AE8584CAA73B)
_LOW, _HALF = np.uint64(2**32 - 1), np.uint64(32)
_FACTOR_LOW, _FACTOR_HIGH = _FACTOR & _LOW, _FACTOR >> _HALF
_SHIFT = np.uint64(11)  # a double has 53 bits of 64
_PIECE = 2**13  # words at a time, which a cache of the processor holds with all that follows


def draw_uniform(key: int, indices: NDArray[np.int64], count: int) -> Array:
    """Return so many random numbers from 0 to 1 of each index (K, count).

    Args:
        key: of 128 bits.
        indices: (K,).
        count: of each.
    """
    blocks = -(-count // 4)
    words = np.empty((len(indices), blocks, 4), np.uint64)
    size = max(1, _PIECE // max(1, blocks))
    for first in range(0, len(indices), size):
        words[first : first + size] = _draw_words(key, indices[first : first + size], blocks)
    digits = words.reshape(len(indices), -1)[:, :count] >> _SHIFT
    return digits.astype(np.float64) * 2.0**-53


def _draw_words(key: int, indices: NDArray[np.int64], blocks: int) -> Words:
    """Return the words of the blocks 1, 2, ... of each index (K, blocks, 4)."""
    shape = len(indices), blocks
    even, odd = np.zeros((2, 2, *shape), np.uint64)  # words 0 and 2, 1 and 3
    even[0], odd[1] = np.arange(1, blocks + 1, dtype=np.uint64), indices.astype(np.uint64)[:, None]
    keys = [key % 2**64, key >> 64]
    for _ in range(ROUNDS):
        high, low = _multiply_words(even)
        even = high[::-1]
        even ^= odd
        even ^= np.array(keys, np.uint64)[:, None, None]
        odd = low[::-1]
        keys = [(word + step) % 2**64 for word, step in zip(keys, _WEYL, strict=True)]
    return np.stack([even[0], odd[0], even[1], odd[1]], axis=-1)


def _multiply_words(words: Words) -> tuple[Words, Words]:
    """Return the high and the low half of the products of words (2, ...) and the multipliers."""
    low, high = words & _LOW, words >> _HALF
    carry = low * _FACTOR_LOW
    carry >>= _HALF
    low *= _FACTOR_HIGH
    low += carry
    np.bitwise_and(low, _LOW, out=carry)
    low >>= _HALF
    carry += high * _FACTOR_LOW
    carry >>= _HALF
    high *= _FACTOR_HIGH
    high += low
    high += carry
    return high, words * _FACTOR
