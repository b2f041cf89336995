"""Values of the numbers that vary, as a function of the campaign's key and the run's index."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from arm_emulator.extension.base import Array, Refusal
from arm_emulator_campaign.sampling.distributions import Distribution

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
    _newest: tuple[int, list[float]] = field(default=(-1, []), repr=False)

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
        # One stream whose counter is set: a new one for each run takes four times as long.
        self._bits = np.random.Philox(counter=np.zeros(4, np.uint64), key=self._key)
        self._fresh = self._bits.state
        self._stream = np.random.Generator(self._bits)

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
    def levels(self) -> int:
        """Combinations of all grids; 1 without any."""
        return math.prod(self.numbers[place].distribution.levels for place in self._grids)

    def draw_uniforms(self, index: int) -> list[float]:
        """Return the random numbers of a run from 0 to 1: for each that varies, and one more."""
        if self._newest[0] != index:
            self._fresh["state"]["counter"][3] = index
            self._bits.state = self._fresh
            self._newest = index, self._stream.random(len(self.numbers) + 1).tolist()
        return self._newest[1]

    def values(self, index: int) -> dict[str, float]:
        """Return the values of a run by name."""
        u = self._draw_point(index)
        return {
            number.name: number.distribution.at(at, number.nominal)
            for number, at in zip(self.numbers, u, strict=True)
        }

    def place_values(self, z: Sequence[float] | Array) -> dict[str, float]:
        """Return the values at a point of independent standard normal numbers (D,), by name."""
        shares = self._shares(np.asarray(z, np.float64))
        return {
            number.name: number.distribution.at(share, number.nominal)
            for share, number in zip(shares, self.numbers, strict=True)
        }

    def _shares(self, z: Array) -> list[float]:
        """Return what share of each number's values lies below its value at a point."""
        scores = z.copy()
        if self._mixed is not None:
            for place in self._coupled:
                scores[place] = math.fsum((self._mixed[place] * z).tolist())
        shares: list[float] = np.clip(special.ndtr(scores), _FIRST, _LAST).tolist()
        return shares

    def _draw_point(self, index: int) -> list[float]:
        """Return a point of the unit cube, a number for each that varies."""
        u = [0.5] * len(self.numbers)
        for place, at in zip(self._free, self._draw_free_point(index), strict=True):
            u[place] = min(max(at, _FIRST), _LAST)
        if self._mixed is not None:
            shares = self._shares(special.ndtri(u))
            for place in self._free:
                u[place] = shares[place]
        rest = index
        for place in reversed(self._grids):
            levels = self.numbers[place].distribution.levels
            rest, level = divmod(rest, levels)
            u[place] = (level + 0.5) / levels
        return u

    def _draw_free_point(self, index: int) -> list[float]:
        D = len(self._free)
        if D == 0:
            return []
        if self.sampling == "sobol":
            return self._draw_sobol_point(index, D)
        if self.sampling == "latin" and index < self.count:
            if self._cube is None:
                from scipy.stats import qmc  # takes long to import

                cube = qmc.LatinHypercube(D, seed=self._make_common_stream())
                self._cube = cube.random(self.count)
            row: list[float] = self._cube[index].tolist()
            return row
        return self.draw_uniforms(index)[:D]

    def _draw_sobol_point(self, index: int, D: int) -> list[float]:
        at, sequence = self._sobol or (0, None)
        if sequence is None or at > index:
            from scipy.stats import qmc  # takes long to import

            at, sequence = 0, qmc.Sobol(D, scramble=True, seed=self._make_common_stream())
        if index > at:
            sequence.fast_forward(index - at)
        point: list[float] = sequence.random(1)[0].tolist()
        self._sobol = index + 1, sequence
        return point

    def _make_common_stream(self) -> np.random.Generator:
        """Return the random numbers that all runs share."""
        return np.random.Generator(np.random.Philox(np.random.SeedSequence(self._key)))


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
