"""A run before it is simulated: all that decides it, beside the campaign."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_emulator.extension.base import Array
from arm_emulator.extension.machine import LARGEST_SEED
from arm_emulator_campaign.sampling.variation import Variation


@dataclass(frozen=True)
class Case:
    """A run before it is simulated.

    Attributes:
        index: its number.
        values: of what varies, by name.
        seed: of the sensors' noise.
        reseeds: ticks before which the noise gets another seed, ascending, and the seeds: a run
            that was forked there.
        without: faults of the file that do not happen.
        seconds: after which it ends, if the scenario does not end before.
    """

    index: int
    values: Mapping[str, float]
    seed: float
    without: frozenset[str] = frozenset()
    seconds: float = math.inf
    reseeds: tuple[tuple[int, float], ...] = ()


@dataclass(frozen=True)
class Cases(Sequence[Case]):
    """Several runs before they are simulated, a row for each.

    Attributes:
        names: of what varies.
        indices: (K,).
        values: of what varies (K, D).
        seeds: (K,).
        without, seconds, reseeds: of all of them, see `Case`.
    """

    names: Sequence[str]
    indices: NDArray[np.int64]
    values: Array
    seeds: Array
    without: frozenset[str] = frozenset()
    seconds: float = math.inf
    reseeds: tuple[tuple[int, float], ...] = ()

    @classmethod
    def stack_runs(cls, runs: Sequence[Case]) -> Cases:
        """Return runs, one at least, that differ in values, indices and seeds alone."""
        shared = {(case.without, case.seconds, case.reseeds) for case in runs}
        assert len(shared) == 1
        names = [*runs[0].values]
        values = np.array([[case.values[name] for name in names] for case in runs], np.float64)
        indices = np.array([case.index for case in runs], np.int64)
        seeds = np.array([case.seed for case in runs])
        return cls(names, indices, values.reshape(len(runs), -1), seeds, *shared.pop())

    def __len__(self) -> int:
        return len(self.indices)

    @overload
    def __getitem__(self, place: int) -> Case: ...
    @overload
    def __getitem__(self, place: slice) -> Cases: ...
    def __getitem__(self, place: int | slice) -> Case | Cases:
        """Return one of the runs, or several."""
        if isinstance(place, slice):
            rows = self.indices[place], self.values[place], self.seeds[place]
            return Cases(self.names, *rows, self.without, self.seconds, self.reseeds)
        values = dict(zip(self.names, self.values[place].tolist(), strict=True))
        run = int(self.indices[place]), values, float(self.seeds[place])
        return Case(*run, self.without, self.seconds, self.reseeds)


def draw_cases(variation: Variation, indices: ArrayLike) -> Cases:
    """Return the runs that sampling draws at indices (K,)."""
    places = np.asarray(indices, np.int64)
    values, uniform = variation.draw_values(places)
    return Cases(variation.names, places, values, np.floor(uniform * LARGEST_SEED))


def draw_case(variation: Variation, index: int) -> Case:
    """Return the run that sampling draws at an index."""
    return draw_cases(variation, [index])[0]


def place_cases(variation: Variation, indices: ArrayLike, z: ArrayLike) -> Cases:
    """Return the runs at points of independent standard normal numbers (K, D)."""
    values = variation.place_values(np.asarray(z, np.float64))
    seeds = [_derive_seed(variation, row) for row in values]
    return Cases(variation.names, np.asarray(indices, np.int64), values, np.array(seeds))


def place_case(variation: Variation, index: int, z: Sequence[float] | Array) -> Case:
    """Return the run at a point of independent standard normal numbers (D,)."""
    return place_cases(variation, [index], np.array([z]))[0]


def make_case(variation: Variation, index: int, values: Mapping[str, float]) -> Case:
    """Return the run with some values; its noise follows from these, too."""
    row = np.array([values[name] for name in variation.names], np.float64)
    return Case(index, dict(values), _derive_seed(variation, row))


def _derive_seed(variation: Variation, row: Array) -> float:
    """Return a seed that follows from the values of a run (D,)."""
    digest = hashlib.sha256(variation.key + row.tobytes()).digest()
    share = int.from_bytes(digest[:8], "little") / 2.0**64
    return float(math.floor(share * LARGEST_SEED))
