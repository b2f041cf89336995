"""Sensitivity: which of the numbers that vary move a margin or a measure, and by how much."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy import special

from arm_emulator.extension.base import Array, Section, number
from arm_emulator_campaign.sampling.variation import Variation
from arm_emulator_campaign.search.method import Finding, Method, Sampler

CONFIDENCE = 0.95
TAIL = 0.01  # on either side of the quantiles that Morris' steps keep within


@dataclass(frozen=True, kw_only=True)
class Sensitivity(Method):
    """Base of both: SALib chooses points of the unit cube and analyses the outputs there."""

    package: ClassVar[tuple[str, ...]] = ("SALib", "SALib")
    every: ClassVar[bool] = True

    def check_campaign(self, section: Section, variation: Variation) -> None:
        """Refuse numbers that are not independent."""
        super().check_campaign(section, variation)
        if variation.correlation is not None:
            rule = "have independent numbers, for which its indices are defined"
            raise section.make_refusal("method", rule, "correlate", "a file without correlate")

    def _make_findings(
        self,
        rows: Callable[[Array], Sequence[tuple[str | float, ...]]],
        outputs: Mapping[str, Array],
        about: str,
        head: tuple[str, ...],
    ) -> list[Finding]:
        """Return a table of all outputs; one that is not finite everywhere has none."""
        sensitivities: list[tuple[str | float, ...]] = []
        for name, values in outputs.items():
            if not np.isfinite(values).all():
                about += f" {name}: not finite in every run, no indices."
            elif np.ptp(values) == 0.0:
                about += f" {name}: the same in all runs."
            else:
                sensitivities += [(name, *row) for row in rows(values)]
        return [
            Finding(
                "Sensitivity", about, ("output", "number", *head), tuple(sensitivities), head[0]
            )
        ]


@dataclass(frozen=True, kw_only=True)
class Sobol(Sensitivity):
    """Sobol indices: shares of the variance that a number explains alone, and with all others."""

    kind: ClassVar[str] = "sobol"

    base: float = number(
        ends=(2, 2**24), whole=True, default=256,
        text="points of its sequence, a power of two; it runs D + 2 times as many for D numbers"
    )  # fmt: skip

    def check_campaign(self, section: Section, variation: Variation) -> None:
        """Refuse a base for which its sequence is not balanced."""
        super().check_campaign(section, variation)
        if int(self.base) & (int(self.base) - 1):
            raise section.make_refusal("base", "be a power of two", int(self.base))

    def count_runs(self, D: int) -> int:
        """Return how many runs it takes."""
        return int(self.base) * (D + 2)

    def make_sampler(self, names: Sequence[str], outputs: Sequence[str], seed: int) -> Sampler:
        """Return its course."""
        from SALib.analyze import sobol as analysis
        from SALib.sample import sobol as sampling

        problem = _make_problem(names, 0.0)
        seed %= 2**31
        u = sampling.sample(problem, int(self.base), calc_second_order=False, seed=seed)
        values = yield _compute_scores(u)

        def compute_rows(of: Array) -> Sequence[tuple[str | float, ...]]:
            # Of a large mean SALib's estimate keeps few digits.
            centred = (of - of.mean()) / of.std()
            indices = analysis.analyze(
                problem, centred, calc_second_order=False, conf_level=CONFIDENCE, seed=seed
            )
            return _make_rows(names, indices, ("ST", "ST_conf", "S1", "S1_conf"))

        about = (
            f"Shares of the variance, {self.count_runs(len(names))} runs, +- at {CONFIDENCE:.0%}."
        )
        head = ("in all", "+- in all", "alone", "+- alone")
        return self._make_findings(
            compute_rows, dict(zip(outputs, values.T, strict=True)), about, head
        )


@dataclass(frozen=True, kw_only=True)
class Morris(Sensitivity):
    """Morris' elementary effects: few runs, to find the numbers that matter at all."""

    kind: ClassVar[str] = "morris"

    trajectories: float = number(
        ends=(2, 10**6), whole=True, default=20,
        text="each has D + 1 runs for D numbers, and changes one number after the other"
    )  # fmt: skip
    levels: float = number(
        ends=(4, 64), whole=True, default=4, text="of each number, an even count"
    )

    def check_campaign(self, section: Section, variation: Variation) -> None:
        """Refuse an odd count of levels."""
        super().check_campaign(section, variation)
        if int(self.levels) % 2:
            raise section.make_refusal("levels", "be even", int(self.levels))

    def count_runs(self, D: int) -> int:
        """Return how many runs it takes."""
        return int(self.trajectories) * (D + 1)

    @property
    def _part(self) -> float:
        """Part of the range between the outer quantiles that a step spans, as Morris chose it."""
        return 0.5 * self.levels / (self.levels - 1.0)

    def make_sampler(self, names: Sequence[str], outputs: Sequence[str], seed: int) -> Sampler:
        """Return its course."""
        from SALib.analyze import morris as analysis
        from SALib.sample import morris as sampling

        problem = _make_problem(names, TAIL)  # the ends of a normal distribution are at infinity
        levels, seed = int(self.levels), seed % 2**31
        u = sampling.sample(problem, int(self.trajectories), num_levels=levels, seed=seed)
        values = yield _compute_scores(u)

        def compute_rows(of: Array) -> Sequence[tuple[str | float, ...]]:
            indices = analysis.analyze(
                problem, u, of, num_levels=levels, conf_level=CONFIDENCE, seed=seed
            )
            return _make_rows(names, indices, ("mu_star", "mu_star_conf", "mu", "sigma"))

        low, high = 100.0 * TAIL, 100.0 * (TAIL + (1.0 - 2.0 * TAIL) * self._part)
        about = (
            f"Change of an output by a step of a number between two of its quantiles, such as "
            f"{low:g} and {high:.3g} %, divided by {self._part:.3g}, the part that a step spans of "
            f"the range from {low:g} to {100.0 - low:g} %; "
            f"{self.count_runs(len(names))} runs, +- at {CONFIDENCE:.0%}."
        )
        head = ("size", "+- size", "mean", "spread")
        return self._make_findings(
            compute_rows, dict(zip(outputs, values.T, strict=True)), about, head
        )


def _make_problem(names: Sequence[str], tail: float) -> dict[str, Any]:
    return {
        "num_vars": len(names), "names": list(names), "bounds": [[tail, 1.0 - tail]] * len(names),
    }  # fmt: skip


def _make_rows(
    names: Sequence[str], indices: Mapping[str, Array], keys: Sequence[str]
) -> Sequence[tuple[str | float, ...]]:
    """Return each number's name and indices, the largest first index on top."""
    order = np.argsort(-np.asarray(indices[keys[0]]), kind="stable")
    return [(names[k], *(float(indices[key][k]) for key in keys)) for k in order]


def _compute_scores(u: Array) -> Array:
    """Return the normal scores of points of the unit cube, whose faces are at 8.2 deviations."""
    return np.asarray(special.ndtri(np.clip(u, 2.0**-53, 1.0 - 2.0**-53)))
