"""Products of matrices with the same bits on every processor.

BLAS, behind the operator of NumPy, sums in an order of its own and with fused products, for each
kind of processor otherwise.
"""

from functools import reduce
from typing import Any

import numpy as np
import numpy.typing as npt

from arm_emulator.base.arrays import Array


def multiply_matrices(*factors: Array) -> Array:
    """Return the product of matrices, or of stacks of them (..., N, K), from left to right."""
    return reduce(_multiply_two, factors)


def apply_matrix(A: Array, v: npt.ArrayLike) -> Array:
    """Return A v of a matrix (..., N, K) and a vector (..., K), or of stacks of them."""
    return multiply_matrices(A, np.asarray(v, np.float64)[..., None])[..., 0]


def multiply_scalar(a: Array, b: Array) -> float:
    """Return the scalar product of two vectors."""
    return float(apply_matrix(a[None], b)[0])


def measure_length(v: Array) -> float:
    """Return the length of a vector."""
    return float(np.sqrt(multiply_scalar(v, v)))


def _multiply_two(A: Array, B: Array) -> Array:
    terms: list[Any] = [A[..., :, k, None] * B[..., None, k, :] for k in range(A.shape[-1])]
    total: Array = reduce(np.add, terms)
    return total
