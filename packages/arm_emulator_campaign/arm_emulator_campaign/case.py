"""A run before it is simulated: all that decides it, beside the campaign."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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


def draw_case(variation: Variation, index: int) -> Case:
    """Return the run that sampling draws at an index."""
    seed = float(math.floor(variation.draw_uniforms(index)[-1] * LARGEST_SEED))
    return Case(index, variation.values(index), seed)


def place_case(variation: Variation, index: int, z: Sequence[float] | NDArray[np.float64]) -> Case:
    """Return the run at a point of independent standard normal numbers (D,)."""
    return make_case(variation, index, variation.place_values(z))


def make_case(variation: Variation, index: int, values: Mapping[str, float]) -> Case:
    """Return the run with some values; its noise follows from these, too."""
    row = np.array([values[number.name] for number in variation.numbers], np.float64)
    digest = hashlib.sha256(variation.key + row.tobytes()).digest()
    share = int.from_bytes(digest[:8], "little") / 2.0**64
    return Case(index, dict(values), float(math.floor(share * LARGEST_SEED)))
