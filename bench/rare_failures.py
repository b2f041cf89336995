"""Subset simulation of a campaign's rare failure, beside OpenTURNS' on the same machine.

Both draw the same normal numbers, drive one simulator in this process, and are timed by its
processor time. OpenTURNS gives the coefficient of variation of one estimate, ours an interval from
repetitions. It wants requirements-bench.txt.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import openturns as ot
from numpy.typing import NDArray

from arm_emulator.base.refusal import Refusal
from arm_emulator.campaign.campaign_file import load_campaign
from arm_emulator.campaign.case import case_at
from arm_emulator.campaign.search.subset import Subset
from arm_emulator.campaign.simulator import Simulator

Array = NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[1]


class Margins:
    """Margins of a requirement at points of independent standard normal numbers.

    Attributes:
        runs: that were simulated.

    Args:
        file: of a campaign with a search by subset simulation.

    Raises:
        Refusal: another campaign.
    """

    def __init__(self, file: Path) -> None:
        self.campaign = campaign = load_campaign(file)
        if not isinstance(campaign.search, Subset) or not campaign.search.of:
            raise Refusal(file.name, "search", "be of subset, with `of`", campaign.search)
        self.method = campaign.search
        self.runs = 0
        self._simulator = Simulator(campaign)

    def __call__(self, points: Array) -> Array:
        """Return the margins (K, 1) of points (K, D)."""
        found = np.empty((len(points), 1))
        for k, z in enumerate(points):
            case = case_at(self.campaign.variation, self.runs, z)
            found[k] = self._simulator.run(case).robustness[self.method.of]
            self.runs += 1
        return found


def ours(margins: Margins, seed: int) -> str:
    """Return the estimate of our subset simulation."""
    names = [one.name for one in margins.campaign.variation.numbers]
    course = margins.method.course(names, [margins.method.of], seed)
    points = next(course)
    while True:
        try:
            points = course.send(margins(points))
        except StopIteration as end:
            (finding,) = end.value
            _, mean, low, high, _ = finding.rows[0]
            return f"{mean:.2e}, 95 % within {low:.1e} and {high:.1e}"


def theirs(margins: Margins, seed: int) -> str:
    """Return the estimate of OpenTURNS, of as many runs a level as all our repetitions have."""
    ot.RandomGenerator.SetSeed(seed)
    D = len(margins.campaign.variation.numbers)
    function = ot.PythonFunction(D, 1, func_sample=lambda rows: margins(np.array(rows)))
    of = ot.CompositeRandomVector(function, ot.RandomVector(ot.Normal(D)))
    method = margins.method
    search = ot.SubsetSampling(ot.ThresholdEvent(of, ot.Less(), 0.0), 2.0, method.share)
    block = round(1.0 / method.share)
    search.setBlockSize(block)
    search.setMaximumOuterSampling(int(method.per_level * method.repetitions) // block)
    search.run()
    result = search.getResult()
    p, spread = result.getProbabilityEstimate(), result.getCoefficientOfVariation()
    return f"{p:.2e}, coefficient of variation {spread:.2f}"


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(prog="bench.rare_failures", description=__doc__)
    parser.add_argument("file", type=Path, nargs="?", default=ROOT / "examples/search.yaml")
    parser.add_argument("--seeds", type=int, default=1)
    given = parser.parse_args()
    margins = Margins(given.file)
    margins(np.zeros((20, len(margins.campaign.variation.numbers))))
    print("| method | probability | runs | CPU s | CPU us a run |\n|---|---|---|---|---|")
    methods: dict[str, Callable[[Margins, int], str]] = {"ours": ours, "OpenTURNS": theirs}
    for seed in range(given.seeds):
        for name, method in methods.items():
            before, began = margins.runs, time.process_time()
            found = method(margins, seed)
            took, runs = time.process_time() - began, margins.runs - before
            print(f"| {name} | {found} | {runs} | {took:.1f} | {1e6 * took / runs:.0f} |")


if __name__ == "__main__":
    main()
