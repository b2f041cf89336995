"""Runs of two campaigns by all cores: closed loops of ur5, and three_axis with a fault each.

`--count` runs of each are simulated, judged and written, as `arm_emulator campaign` does. Their
time is scaled to a million; some of the runs are compared with single ones. `judging` is the share
of a run that its requirements and measures take, in this process, in turns with and without them.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import resource
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml

from arm_emulator.campaign.campaign_file import Campaign, load_campaign
from arm_emulator.campaign.case import drawn_case
from arm_emulator.campaign.crew import Crew
from arm_emulator.campaign.executor import LocalPool, run_campaign, seconds_per_run
from arm_emulator.campaign.lanes import runs_of
from arm_emulator.campaign.results import MEASURE, ROBUSTNESS, Results, digest_of
from arm_emulator.campaign.simulator import Simulator
from arm_emulator.machine.scene import load_scene

MILLION, COMPARED, PAIRS = 1_000_000, 20, 15
ASKED = {"loops": 120.0, "faults": 180.0}  # s for a million on two cores
LOOPS = {
    "scene": "ur5",
    "set": {"payload": 1.0},
    "scenario": {"seconds": 1.0, "table": "targets.csv"},
    "vary": {"payload.mass": "uniform(0, 3)"},
    "requirements": {"near": "always abs(error.*) < 0.1"},
    "measures": {"error": "max(abs(error.*))"},
}
FAULTS = {
    "scene": "three_axis",
    "scenario": {"seconds": 1.0, "targets": [{"at": 0.0, "waist": 0.3, "elbow": 1.0}]},
    "faults": {
        "push": {"kind": "wrench", "at": 0.5, "lasting": 0.05, "link": "tool", "force": [0, 0, 0]}
    },
    "vary": {"faults.push.force.2": "normal(0, 150)", "faults.push.at": "uniform(0.1, 0.9)"},
    "requirements": {"near": "always[0.6, end] abs(error.*) < 0.1"},
    "measures": {"error": "max(abs(error.*))"},
}


def write_targets(file: Path) -> None:
    """Write a table of swings of every joint of ur5, a row every 10 ms."""
    scene, rng = load_scene("ur5"), np.random.default_rng(1)
    t = np.arange(0.0, 1.0, 0.01)[:, np.newaxis]
    size, rate = rng.uniform(-0.5, 0.5, 6), rng.uniform(1.0, 4.0, 6)
    rows = np.hstack([t, scene.start + size * (1.0 - np.cos(rate * t))])
    np.savetxt(file, rows, delimiter=",", header="t," + ",".join(scene.joint_names), comments="")


def run(name: str, data: Mapping[str, object], count: int, workers: int, folder: Path) -> str:
    """Simulate a campaign; return a row of the table."""
    file = folder / f"{name}.yaml"
    file.write_text(yaml.safe_dump({**data, "count": count}, sort_keys=False))
    campaign = load_campaign(file)
    seconds, _ = seconds_per_run(campaign)  # compiles, too
    results = Results(folder / name, campaign)
    began, used = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    crew = Crew(lambda: LocalPool(workers), seconds, lambda progress: None)
    run_campaign(campaign, results, crew)
    wall, now = time.monotonic() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime
    columns = results.columns()
    million = wall * MILLION / count
    return (
        f"| {name} | {count} | {wall:.1f} | {1e6 * spent / count:.0f} | {million:.0f} | "
        f"{ASKED[name]:.0f} | {off(campaign, columns):.1e} | {100.0 * judging(campaign):.1f} % | "
        f"{digest_of(columns)[:12]} |"
    )


def off(campaign: Campaign, columns: dict[str, np.ndarray]) -> float:
    """Return how far some runs are from their single runs, in all that is kept of them."""
    alone, most = Simulator(campaign), 0.0
    for index in np.random.default_rng(2).integers(0, campaign.count, COMPARED).tolist():
        one = alone.run(index)
        named = {f"{ROBUSTNESS}{key}": value for key, value in one.robustness.items()}
        named |= {f"{MEASURE}{key}": value for key, value in one.measures.items()}
        most = max(most, *(abs(columns[key][index] - value) for key, value in named.items()))
    return most


def judging(campaign: Campaign) -> float:
    """Return the share of a run that its requirements and measures take: a median of pairs."""
    free = dataclasses.replace(campaign, requirements={}, measures={})
    both = [runs_of(one) for one in (campaign, free)]
    cases = [drawn_case(campaign.variation, index) for index in range(both[0].width)]
    spent = np.zeros((PAIRS + 1, 2))  # the first pair warms up
    for row in spent:
        for k, one in enumerate(both):
            began = time.process_time()
            list(one.runs(cases))
            row[k] = time.process_time() - began
    return float(np.median(1.0 - spent[1:, 1] / spent[1:, 0]))


def report(count: int, workers: int, only: str) -> str:
    """Simulate both, and return a table in Markdown."""
    rows = [
        "| runs of 1 s | count | wall s | us of CPU each | s a million | asked | off | judging | "
        "digest |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        write_targets(folder / "targets.csv")
        for name, data in (("loops", LOOPS), ("faults", FAULTS)):
            if only in ("", name):
                rows.append(run(name, data, count, workers, folder))
    return "\n".join(rows)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="bench.many_runs", description=__doc__)
    parser.add_argument("--count", type=int, default=100_000, help="runs of each campaign")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--only", choices=("loops", "faults"), default="")
    given = parser.parse_args()
    print(report(given.count, given.workers, given.only))


if __name__ == "__main__":
    main()
