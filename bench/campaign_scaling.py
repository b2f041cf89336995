"""Campaigns on clusters that are not at hand: their scheduler, simulated with measured costs.

A client keeps two chunks of runs under way for each worker. A scheduler serves one message at a
time: it hands a chunk out, and takes its end. Workers simulate their chunks and write parts.
"""

from __future__ import annotations

import argparse
import heapq

import numpy as np

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


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(prog="bench.campaign_scaling", description=__doc__)
    parser.add_argument("--per-run", type=float, default=4e-4, help="s of a run")
    parser.add_argument("--chunk", type=float, default=1.5, help="s of a chunk")
    parser.add_argument("--runs", type=float, default=1e9)
    given = parser.parse_args()
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
