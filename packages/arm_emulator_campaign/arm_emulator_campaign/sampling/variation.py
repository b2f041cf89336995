"""Values of the numbers that vary, as a function of the campaign's key and the run's index."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import special

from arm_emulator.extension.base import Array, Refusal
from arm_emulator_campaign.sampling.distributions import Distribution
from arm_emulator_campaign.sampling.philox import draw_uniform

if TYPE_CHECKING:
    from scipy.stats import qmc

SAMPLINGS = ("random", "sobol", "latin")
MAX_SOBOL = 21_201  # dimensions that SciPy has directions for
LARGEST_LATIN = 5 * 10**7  # numbers of a Latin hypercube, which every worker holds
_FIRST, _LAST = 2.0**-54, 1.0 - 2.0**-53


@dataclass(frozen=True)
class Varying:
    """A number that varies: its name, its unit, its distribution, and its nominal value."""

    name: str
    unit: str
    distribution: Distribution
    nominal: float


@dataclass
class Variation:
    """All varied numbers.

    Args:
        numbers: that vary, in a fixed order.
        sampling: one of `SAMPLINGS`.
        key: of the campaign, 32 bytes.
        count: of runs, which a Latin hypercube divides.
        correlation: of the normal scores of the numbers (D, D); None: they are independent.
        where: for refusals.

    Raises:
        Refusal: correlations that contradict each other, or too many numbers for a sampling.
    """

    numbers: Sequence[Varying]
    sampling: str
    key: bytes
    count: int
    correlation: Array | None = None
    where: str = "campaign"
    _cube: Array | None = field(default=None, repr=False)
    _sobol: tuple[int, qmc.Sobol] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        grids = [place for place, number in enumerate(self.numbers) if number.distribution.levels]
        self._grids = grids
        self._free = [place for place in range(len(self.numbers)) if place not in grids]
        D = len(self._free)
        if self.sampling == "sobol" and D > MAX_SOBOL:
            rule = f"be random or latin with more than {MAX_SOBOL} numbers"
            raise Refusal(self.where, "sampling", rule, "sobol")
        if self.sampling == "latin" and D * self.count > LARGEST_LATIN:
            rule = f"be random or sobol with more than {LARGEST_LATIN:g} numbers in all"
            raise Refusal(self.where, "sampling", rule, f"latin, {D * self.count}")
        self._mixed = (
            None if self.correlation is None else self._factor_correlation(self.correlation)
        )
        self._key = int.from_bytes(self.key[:16], "little")
        alone = np.eye(len(self.numbers))
        mixed = alone if self._mixed is None else self._mixed
        self._coupled = [block for block in self._free if np.any(mixed[block] != alone[block])]

    def _factor_correlation(self, correlation: Array) -> Array:
        try:
            return np.asarray(np.linalg.cholesky(correlation), np.float64)
        except np.linalg.LinAlgError:
            root = _factor_dependent(correlation)
        if np.max(np.abs(root @ root.T - correlation)) > 1e-9:
            eigenvalue = float(np.linalg.eigvalsh(correlation)[0])
            rule = "have correlations that can hold together, all eigenvalues >= 0"
            raise Refusal(self.where, "correlate", rule, f"{eigenvalue:.3g}")
        return root

    @property
    def names(self) -> list[str]:
        """The names of the numbers."""
        return [number.name for number in self.numbers]

    @property
    def levels(self) -> int:
        """Combinations of all grids; 1 without any."""
        return math.prod(self.numbers[place].distribution.levels for place in self._grids)

    def draw_values(self, indices: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the values of runs (K, D), and one more random number from 0 to 1 of each (K,)."""
        uniform = draw_uniform(self._key, indices, len(self.numbers) + 1)
        return self._take_quantiles(self._draw_points(indices, uniform)), uniform[:, -1]

    def place_values(self, z: Array) -> Array:
        """Return the values at points of independent standard normal numbers, (K, D) each."""
        return self._take_quantiles(self._compute_shares(np.asarray(z, np.float64)))

    def _take_quantiles(self, shares: Array) -> Array:
        values = np.empty_like(shares)
        for place, number in enumerate(self.numbers):
            values[:, place] = number.distribution.evaluate_at(shares[:, place], number.nominal)
        return values

    def _compute_shares(self, z: Array) -> Array:
        """Return what share of each number's values lies below its value at points (K, D)."""
        scores = z.copy()
        if self._mixed is not None:
            for place in self._coupled:
                scores[:, place] = _sum_products(self._mixed[place], z)
        shares: Array = np.clip(special.ndtr(scores), _FIRST, _LAST)
        return shares

    def _draw_points(self, indices: NDArray[np.int64], uniform: Array) -> Array:
        """Return points of the unit cube, a number for each that varies (K, D)."""
        u = np.full((len(indices), len(self.numbers)), 0.5)
        if self._free:
            u[:, self._free] = np.clip(self._draw_free_points(indices, uniform), _FIRST, _LAST)
        if self._mixed is not None:
            u[:, self._free] = self._compute_shares(special.ndtri(u))[:, self._free]
        rest = indices
        for place in reversed(self._grids):
            levels = self.numbers[place].distribution.levels
            rest, level = np.divmod(rest, levels)
            u[:, place] = (level + 0.5) / levels
        return u

    def _draw_free_points(self, indices: NDArray[np.int64], uniform: Array) -> Array:
        D = len(self._free)
        if self.sampling == "sobol":
            return self._draw_sobol_points(indices, D)
        points = uniform[:, :D].copy()
        if self.sampling == "latin":
            if self._cube is None:
                from scipy.stats import qmc  # takes long to import

                cube = qmc.LatinHypercube(D, seed=self._make_common_stream())
                self._cube = cube.random(self.count)
            inside = indices < self.count
            points[inside] = self._cube[indices[inside]]
        return points

    def _draw_sobol_points(self, indices: NDArray[np.int64], D: int) -> Array:
        points = np.empty((len(indices), D))
        begins = np.flatnonzero(np.diff(indices, prepend=indices[:1] - 2) != 1)
        for first, end in itertools.pairwise([*begins.tolist(), len(indices)]):
            points[first:end] = self._draw_sobol_sequence(int(indices[first]), end - first, D)
        return points

    def _draw_sobol_sequence(self, index: int, count: int, D: int) -> Array:
        """Return so many points of Sobol's sequence from an index on."""
        at, sequence = self._sobol or (0, None)
        if sequence is None or at > index:
            from scipy.stats import qmc  # takes long to import

            at, sequence = 0, qmc.Sobol(D, scramble=True, seed=self._make_common_stream())
        if index > at:
            sequence.fast_forward(index - at)
        self._sobol = index + count, sequence
        # SciPy warns of a first call for another count than a power of two.
        several = [sequence.random(1), *([sequence.random(count - 1)] if count > 1 else [])]
        return np.concatenate(several)

    def _make_common_stream(self) -> np.random.Generator:
        """Return the random numbers that all runs share."""
        return np.random.Generator(np.random.Philox(np.random.SeedSequence(self._key)))


def _sum_products(factors: Array, z: Array) -> Array:
    """Return the sum of all factors (D,) times numbers (K, D), rounded once (K,)."""
    some = np.flatnonzero(factors)
    products = factors[some] * z[:, some]
    if products.shape[1] <= 2:
        return np.asarray(np.sum(products, axis=1), np.float64)
    return np.fromiter(map(math.fsum, products.tolist()), np.float64, len(products))


def _factor_dependent(matrix: Array) -> Array:
    """Return the lower root of a matrix whose numbers may follow from those before, as with +-1.

    Of a matrix that has none it is any other's: the caller compares.
    """
    root = np.zeros_like(matrix)
    for k in range(len(matrix)):
        rest = matrix[k:, k] - root[k:, :k] @ root[k, :k]
        if rest[0] > 1e-12:  # rounding leaves some 1e-16 of a number that follows
            root[k:, k] = rest / math.sqrt(rest[0])
    return root


def make_correlation(
    pairs: Sequence[tuple[Sequence[str], float]], numbers: Sequence[Varying], where: str
) -> Array | None:
    """Return the correlation matrix of the varied numbers; None: all are independent.

    Args:
        pairs: names of numbers, and the correlation of each with each.
        numbers: that vary.
        where: for refusals.

    Raises:
        Refusal: a grid, which takes all its values in turn.
    """
    if not pairs:
        return None
    places: Mapping[str, int] = {number.name: place for place, number in enumerate(numbers)}
    matrix = np.eye(len(numbers))
    for names, by in pairs:
        for first in names:
            if numbers[places[first]].distribution.levels:
                raise Refusal(where, "correlate", "name numbers that are drawn", f"a grid, {first}")
            for second in names:
                if first != second:
                    matrix[places[first], places[second]] = by
    return matrix
