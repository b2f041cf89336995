"""Data that are kept of runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import Array
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.simulation.case import Case


@dataclass(frozen=True)
class Outcome:
    """Data that are kept of a run.

    Attributes:
        index: of the run.
        values: of what varies, by name.
        robustness: of each requirement; -inf in a run that diverged.
        measures: by name; NaN in a run that diverged.
        diverged: when the integration failed [s]; NaN: it did not.
    """

    index: int
    values: Mapping[str, float]
    robustness: Mapping[str, float]
    measures: Mapping[str, float]
    diverged: float

    @classmethod
    def create_from_judged(cls, campaign: Campaign, case: Case, judged: Outcomes) -> Outcome:
        """Return the outcome of a run that was judged alone."""
        diverged = float(judged.diverged[0])
        return cls(
            case.index,
            case.values,
            dict(zip(campaign.requirements, judged.robustness[0].tolist(), strict=True)),
            dict(zip(campaign.measures, judged.measures[0].tolist(), strict=True)),
            # Python finds equal outcomes equal only if their NaN is the same object.
            diverged if math.isfinite(diverged) else math.nan,
        )

    @property
    def has_failed(self) -> bool:
        """Whether a requirement does not hold."""
        return math.isfinite(self.diverged) or any(not r >= 0.0 for r in self.robustness.values())


@dataclass(frozen=True)
class Outcomes:
    """The same of several runs, a row for each.

    Attributes:
        indices: of the runs (K,).
        values: of what varies (K, D).
        robustness: (K, R).
        measures: (K, M).
        diverged: (K,) [s].
    """

    indices: NDArray[np.int64]
    values: Array
    robustness: Array
    measures: Array
    diverged: Array

    @classmethod
    def join_outcomes(cls, several: Sequence[Outcomes]) -> Outcomes:
        """Return the runs of several, one after the other; of one at least."""
        names = cls.__dataclass_fields__
        return cls(
            *(np.concatenate([getattr(outcome, name) for outcome in several]) for name in names)
        )

    def __len__(self) -> int:
        return len(self.indices)

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Whether each run breaks a requirement (K,)."""
        broken = ~(self.robustness >= 0.0)
        failed: NDArray[np.bool_] = np.isfinite(self.diverged) | np.any(broken, axis=1)
        return failed
