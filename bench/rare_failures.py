"""A rare failure by brute force, by our subset simulation, and by OpenTURNS' of the exported FMU.

An arm's power is cut, and it sinks until its shorted windings have nearly stopped it. Brute force
draws the numbers with NumPy, and sends them to a fleet without campaign, servo and judges.
OpenTURNS drives an FMU of the same machine through FMPy, alone in its process as ours is. All times
are the processor's. It wants requirements-bench.txt and requirements-peers.txt.
"""

from __future__ import annotations

import argparse
import fnmatch
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import fmpy
import numpy as np
import openturns as ot
import yaml
from fmpy.fmi3 import FMU3Slave
from numpy.typing import NDArray
from scipy import special

from arm_emulator import Fleet
from arm_emulator.campaign.campaign_file import Campaign, load_campaign
from arm_emulator.campaign.case import case_at
from arm_emulator.campaign.intervals import clopper_pearson
from arm_emulator.campaign.lanes import runs_of
from arm_emulator.campaign.search.subset import Subset
from arm_emulator.doors.fmu.export import export

Array = NDArray[np.float64]
SECONDS, WIDTH, CONFIDENCE = 0.05, 1024, 0.95
SCATTER = {  # standard deviations of the logarithms, about the scene's numbers
    "payload.mass": 0.3,
    "joints.*.friction.viscous": 0.5,
    "joints.*.gear.stiffness": 0.15,
    "joints.*.motor.resistance": 0.1,
}
LIMITS = {"once in a million": 0.0105, "once in a thousand million": 0.011}  # rad
CAMPAIGN = {
    "scene": "three_axis",
    "set": {"gravity": [0.0, 0.0, -9.81], "payload": {"mass": 1.0, "com": [0.0, 0.0, 0.0]}},
    "scenario": {"seconds": SECONDS},
    "vary": {name: f"nominal * lognormal(1, {sigma})" for name, sigma in SCATTER.items()},
    "faults": {"cut": {"kind": "power_cut", "at": 0.0}},
    "search": {"method": "subset", "of": "holds", "per_level": 1000, "confidence": CONFIDENCE},
}


@dataclass(frozen=True)
class Found:
    """Result of a method: a row of the table."""

    method: str
    seed: int
    p: float
    interval: str
    runs: int
    seconds: float

    @property
    def row(self) -> str:
        """Row in Markdown."""
        cells = (
            self.method, f"{self.seed}", f"{self.p:.2e}", self.interval, f"{self.runs}",
            f"{self.seconds:.1f}", f"{1e6 * self.seconds / self.runs:.1f}",
        )  # fmt: skip
        return f"| {' | '.join(cells)} |"


def campaign_of(limit: float, folder: Path) -> Campaign:
    """Return the campaign that asks how often a joint leaves its start by more than a limit."""
    file = folder / f"{limit}.yaml"
    text = CAMPAIGN | {"requirements": {"holds": f"always abs(error.*) < {limit}"}}
    file.write_text(yaml.safe_dump(text, sort_keys=False), encoding="utf-8")
    return load_campaign(file)


def sigmas(campaign: Campaign) -> Array:
    """Return the deviations of the varied numbers, in the order of the scene (P,)."""
    return np.array(
        [
            sum(sigma for key, sigma in SCATTER.items() if fnmatch.fnmatchcase(one.name, key))
            for one in campaign.scene.varied
        ]
    )


def brute(campaign: Campaign, limits: list[float], count: int, seed: int) -> list[Found]:
    """Return the share of failures by each limit, of the same runs."""
    scene, sigma, rng = campaign.scene, sigmas(campaign), np.random.default_rng(seed)
    own = np.array([one.value for one in scene.varied])
    fleet, steps = Fleet(scene, WIDTH, workers=1), round(SECONDS / scene.integrator.dt)
    command, failed, done = np.zeros(len(scene.joints)), np.zeros(len(limits), int), 0
    began = time.process_time()
    while done < count:
        z = rng.standard_normal((WIDTH, len(own)))
        fleet.set_parameters(own * np.exp(sigma * z - 0.5 * sigma * sigma))
        fleet.reset()
        fleet.powered = False
        # It sinks all the time: it is farthest away at the end.
        off = np.max(np.abs(fleet.advance(command, steps) - scene.start), axis=1)
        failed += [np.count_nonzero(off >= limit) for limit in limits]
        done += WIDTH
    spent = time.process_time() - began
    return [
        Found(f"brute force, {hits} failures", seed, hits / done, _within(hits, done), done, spent)
        for hits in failed.tolist()
    ]


def _within(hits: int, count: int) -> str:
    low, high = clopper_pearson(hits, count, CONFIDENCE)
    return f"{low:.2e} to {high:.2e}"


class Margins:
    """Margins of the requirement at points of independent standard normal numbers, in lanes."""

    def __init__(self, campaign: Campaign) -> None:
        self._variation, self._lanes, self.runs = campaign.variation, runs_of(campaign), 0

    def __call__(self, points: Array) -> Array:
        """Return the margins (K, 1) of points (K, D)."""
        cases = [case_at(self._variation, self.runs + k, z) for k, z in enumerate(points)]
        self.runs += len(cases)
        return np.vstack([one.robustness for one in self._lanes.runs(cases)])


class UnitMargins:
    """The same of the exported unit, by FMPy, one run after the other."""

    def __init__(self, campaign: Campaign, limit: float, folder: Path) -> None:
        scene, self.runs = campaign.scene, 0
        file = folder / f"{scene.name}.fmu"
        export(scene, file, "native")
        description = fmpy.read_model_description(file)
        place = {one.name: one.valueReference for one in description.modelVariables}
        names = [one.name for one in campaign.variation.numbers]
        own = {one.name: one for one in scene.varied}
        self._mean = np.array([own[name].value for name in names])
        by_name = dict(zip(own, sigmas(campaign), strict=True))
        self._sigma = np.array([by_name[name] for name in names])
        self._numbers, self._N = [place[name] for name in names], len(scene.joints)
        self._q, self._power = [place["truth.q"]], [place["power"]]
        self._start, self._limit = scene.start, limit
        self._unit = FMU3Slave(
            guid=description.guid,
            unzipDirectory=fmpy.extract(file, str(folder / scene.name)),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="arm",
        )
        self._unit.instantiate()

    def __call__(self, points: Array) -> Array:
        """Return the margins (K, 1) of points (K, D)."""
        unit, found = self._unit, np.empty((len(points), 1))
        rows = self._mean * np.exp(self._sigma * points - 0.5 * self._sigma * self._sigma)
        for k, row in enumerate(rows):
            unit.setFloat64(self._numbers, row.tolist())
            unit.setBoolean(self._power, [False])
            unit.enterInitializationMode(startTime=0.0)
            unit.exitInitializationMode()
            unit.doStep(currentCommunicationPoint=0.0, communicationStepSize=SECONDS)
            q = unit.getFloat64(self._q, nValues=self._N)
            found[k] = self._limit - np.max(np.abs(q - self._start))
            unit.reset()
        self.runs += len(points)
        return found


def ours(campaign: Campaign, margins: Margins, seed: int) -> Found:
    """Return the estimate of our subset simulation."""
    method, names = campaign.search, [one.name for one in campaign.variation.numbers]
    assert isinstance(method, Subset), "the campaign's search"
    before, began = margins.runs, time.process_time()
    course = method.course(names, [method.of], seed)
    points = next(course)
    while True:
        try:
            points = course.send(margins(points))
        except StopIteration as end:
            _, p, low, high, _ = end.value[0].rows[0]
            spent, runs = time.process_time() - began, margins.runs - before
            return Found("ours, lanes", seed, p, f"{low:.2e} to {high:.2e}", runs, spent)


def theirs(campaign: Campaign, margins: UnitMargins, seed: int) -> Found:
    """Return the estimate of OpenTURNS, of as many runs a level as all our repetitions have."""
    method, D = campaign.search, len(campaign.variation.numbers)
    assert isinstance(method, Subset), "the campaign's search"
    before, began = margins.runs, time.process_time()
    ot.RandomGenerator.SetSeed(seed)
    function = ot.PythonFunction(D, 1, func_sample=lambda rows: margins(np.array(rows)))
    of = ot.CompositeRandomVector(function, ot.RandomVector(ot.Normal(D)))
    search = ot.SubsetSampling(ot.ThresholdEvent(of, ot.Less(), 0.0), 2.0, method.share)
    block = round(1.0 / method.share)
    search.setBlockSize(block)
    search.setMaximumOuterSampling(int(method.per_level * method.repetitions) // block)
    search.run()
    result = search.getResult()
    p = result.getProbabilityEstimate()
    half = p * result.getCoefficientOfVariation() * special.ndtri(0.5 + 0.5 * CONFIDENCE)
    spent, runs = time.process_time() - began, margins.runs - before
    within = f"{max(0.0, p - half):.2e} to {p + half:.2e}"
    return Found("OpenTURNS, FMU", seed, p, within, runs, spent)


def main() -> None:
    """Print a table for each limit."""
    parser = argparse.ArgumentParser(prog="bench.rare_failures", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000_000, help="runs of the brute force")
    parser.add_argument("--seeds", type=int, default=3, help="of subset simulation")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        campaigns = [campaign_of(limit, folder) for limit in LIMITS.values()]
        sampled = brute(campaigns[0], [*LIMITS.values()], given.count, 1) if given.count else []
        for k, (name, limit) in enumerate(LIMITS.items()):
            one = campaigns[k]
            (folder / name).mkdir()
            lanes, unit = Margins(one), UnitMargins(one, limit, folder / name)
            some = np.random.default_rng(1).standard_normal((100, len(one.variation.numbers)))
            off = float(np.max(np.abs(lanes(some) - unit(some))))  # warms up, too
            assert off < 1e-12, off
            print(f"\nFails {name}, farther than {limit:g} rad; lanes and FMU within {off:.0e}:\n")
            print("| method | seed | probability | 95 % | runs | CPU s | CPU us a run |")
            print("|---|---|---|---|---|---|---|")
            for row in sampled[k : k + 1]:
                print(row.row)
            for seed in range(1, given.seeds + 1):
                print(ours(one, lanes, seed).row, flush=True)
                print(theirs(one, unit, seed).row, flush=True)


if __name__ == "__main__":
    main()
