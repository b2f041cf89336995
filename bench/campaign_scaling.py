"""Campaigns by more workers: here, through Dask, and on clusters that are not at hand.

Here: 100 000 runs by one worker, by two, and by two of a Dask cluster, in turns; beside them
processes that only simulate as many, one and two at a time. Efficiency is what two gain of twice
the speed of one. Workers begin within the time that is measured; a cluster's are there, as clusters
are, and have simulated before.

Not at hand (`--simulated`): the scheduler with measured costs. A client keeps two chunks of runs
under way for each worker. A scheduler serves one message at a time: it hands a chunk out, and takes
its end. Workers simulate their chunks and write parts.
"""

from __future__ import annotations

import argparse
import heapq
import itertools
import multiprocessing as mp
import os
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import yaml

from arm_emulator.campaign.campaign_file import load_campaign
from arm_emulator.campaign.case import drawn_case
from arm_emulator.campaign.crew import Crew, Pool
from arm_emulator.campaign.executor import DaskPool, LocalPool, run_campaign, seconds_per_run
from arm_emulator.campaign.lanes import runs_of
from arm_emulator.campaign.results import Results, digest_of
from bench.campaign_kills import LONGEST, Cluster
from bench.many_runs import FAULTS
from bench.measure import processor_time

PER_TASK = {"Dask": 1e-3, "hyperqueue": 1e-4}  # s of the scheduler, hand-out and end together
WAY = 1e-3  # s that a message is on its way
WRITING = 5e-3  # s of a part
SCATTER = 0.1  # of the time of a chunk
MOST_CHUNKS = 40  # of each worker: what follows is alike


def seconds_of(runs: float, workers: int, per_run: float, chunk: float, per_task: float) -> float:
    """Return the wall time of so many runs [s].

    Args:
        runs: in all.
        workers: processes.
        per_run: of a worker [s].
        chunk: time that a chunk takes [s].
        per_task: of the scheduler [s].
    """
    rng = np.random.default_rng(1)
    chunks = int(np.ceil(runs * per_run / chunk))
    simulated = min(chunks, MOST_CHUNKS * workers)
    free, waiting = 0.0, [(0.0, k) for k in range(workers)]
    took = (chunk + WRITING) * np.exp(SCATTER * rng.standard_normal(simulated))
    end = 0.0
    for one in took:
        asked, worker = heapq.heappop(waiting)
        free = max(free, asked + WAY) + per_task
        end = max(end, free + WAY + float(one))
        # A second chunk is at the worker already: it does not wait for the answer, unless the
        # scheduler has not kept up.
        heapq.heappush(waiting, (max(asked + float(one), free - chunk), worker))
    return end * chunks / simulated


def only_simulated(file: Path, first: int, end: int) -> None:
    """Simulate runs of a campaign and keep nothing."""
    campaign = load_campaign(file)
    simulator, variation = runs_of(campaign), campaign.variation
    for begin in range(first, end, simulator.width):
        some = range(begin, min(begin + simulator.width, end))
        list(simulator.runs([drawn_case(variation, index) for index in some]))


class Measured:
    """Wall and processor time of the runs of a campaign, by several ways."""

    def __init__(self, file: Path, cluster: Cluster) -> None:
        self.file, self.campaign = file, load_campaign(file)
        self._seconds, _ = seconds_per_run(self.campaign)  # compiles, too
        self._folder, self._cluster, self._made = file.parent, cluster, 0
        self.digests = set[str]()
        ways: dict[str, Callable[[], None]] = {}
        for count in (1, 2):
            ways[f"{count} bare"] = partial(self._bare, count)
            ways[f"{count} here"] = partial(self._by, partial(LocalPool, count))
        ways["2 of Dask"] = partial(self._by, partial(DaskPool, cluster.options[1], LONGEST))
        self.ways = ways

    def _bare(self, processes: int) -> None:
        ends = np.linspace(0, self.campaign.count, processes + 1).astype(int).tolist()
        spawned = mp.get_context("spawn")
        every = [
            spawned.Process(target=only_simulated, args=(self.file, first, end))
            for first, end in itertools.pairwise(ends)
        ]
        for one in every:
            one.start()
        for one in every:
            one.join()
            assert one.exitcode == 0, "it has simulated its runs"

    def _by(self, pool: Callable[[], Pool]) -> None:
        self._made += 1
        results = Results(self._folder / f"{self._made}", self.campaign)
        run_campaign(self.campaign, results, Crew(pool, self._seconds, lambda progress: None))
        self.digests.add(digest_of(results.columns()))

    def timed(self, way: str) -> tuple[float, float]:
        """Return wall and processor time of all processes for all runs [s]."""
        began, spent = time.monotonic(), self._spent()
        self.ways[way]()
        return time.monotonic() - began, self._spent() - spent

    def _spent(self) -> float:
        own = os.times()
        ended = own.user + own.system + own.children_user + own.children_system
        return ended + sum(processor_time(one) for one in self._cluster.processes)


def measured(count: int, turns: int) -> str:
    """Return tables in Markdown of 1 and 2 workers here, and of a Dask cluster."""
    with tempfile.TemporaryDirectory() as made:
        file = Path(made) / "campaign.yaml"
        file.write_text(yaml.safe_dump({**FAULTS, "count": count}, sort_keys=False))
        cluster = Cluster()
        try:
            of = Measured(file, cluster)
            of.timed("2 of Dask")  # its workers get their machines
            took = {way: np.array([]).reshape(0, 2) for way in of.ways}
            for _ in range(turns):
                for way in of.ways:
                    took[way] = np.vstack([took[way], of.timed(way)])
        finally:
            cluster.end()
    assert len(of.digests) == 1, "all ways have one digest"
    rows = ["| way | wall s | CPU us a run |", "|---|---|---|"]
    for way, times in took.items():
        wall, spent = np.median(times, axis=0)
        rows.append(f"| {way} | {wall:.1f} | {1e6 * spent / count:.0f} |")

    def ratio(way: str, other: str, column: int = 0) -> float:
        return float(np.median(took[way][:, column] / took[other][:, column]))

    one, two = (0.5 * ratio(f"1 {kind}", f"2 {kind}") for kind in ("bare", "here"))
    rows.append(f"\nEfficiency of two: bare {100 * one:.0f} %, campaign {100 * two:.0f} %")
    wall, spent = (ratio("2 of Dask", "2 here", column) for column in (0, 1))
    rows.append(f"Dask over here: {wall:.3f} of the time, {spent:.3f} of the processor's")
    return "\n".join(rows)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(prog="bench.campaign_scaling", description=__doc__)
    parser.add_argument("--count", type=int, default=100_000, help="runs of 1 s, measured")
    parser.add_argument("--turns", type=int, default=1, help="of all ways")
    parser.add_argument("--simulated", action="store_true", help="clusters that are not at hand")
    parser.add_argument("--per-run", type=float, default=4e-4, help="s of a run")
    parser.add_argument("--chunk", type=float, default=1.5, help="s of a chunk")
    parser.add_argument("--runs", type=float, default=1e9)
    given = parser.parse_args()
    if not given.simulated:
        return print(measured(given.count, given.turns))
    print("| workers | " + " | ".join(f"{name}: time, efficiency" for name in PER_TASK) + " |")
    print("|---|" + "---|" * len(PER_TASK))
    for workers in (10, 100, 1000, 3000, 10_000, 30_000):
        cells = []
        for per_task in PER_TASK.values():
            took = seconds_of(given.runs, workers, given.per_run, given.chunk, per_task)
            share = given.runs * given.per_run / workers / took
            cells.append(f"{took / 60.0:.3g} min, {100.0 * share:.0f} %")
        print(f"| {workers} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
