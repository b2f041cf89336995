"""Runs of a campaign by several processes; finished runs outlive any killed process."""

from __future__ import annotations

import concurrent.futures as cf
import itertools
import math
import time
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.execution.worker import Done, get_simulator, simulate_chunk
from arm_emulator_campaign.execution.worker_pool import (
    CampaignProgress,
    Pool,
    Work,
    WorkerPool,
    wait_for_any,
)
from arm_emulator_campaign.results.parts import FAILED, INDEX, ROBUSTNESS, Results, divide_ranges
from arm_emulator_campaign.simulation.batch_simulator import WIDTH, make_simulator
from arm_emulator_campaign.simulation.case import draw_cases

FIRST_STAGE, GROWTH = 200, 1.5  # runs after which a campaign looks whether it may stop


def run_campaign(campaign: Campaign, results: Results, worker_pool: WorkerPool) -> None:
    """Simulate what is missing, to the end or until the campaign may stop.

    Raises:
        Refusal: a run that is not taken, or workers that end again and again.
        KeyboardInterrupt: after what was done has been written.
    """
    columns = results.collect_columns()
    failures = count_failures(campaign, columns, campaign.count)
    progress = CampaignProgress(campaign.count, len(columns[INDEX]), failures=failures)
    for count in list_stages(campaign):
        _complete_runs(campaign, results, worker_pool, progress, count)
        if progress.is_late(campaign.stop.seconds) or may_stop(campaign, results, count):
            return


def _complete_runs(
    campaign: Campaign,
    results: Results,
    worker_pool: WorkerPool,
    progress: CampaignProgress,
    count: int,
) -> None:
    """Simulate what is missing among the first `count` runs."""

    def simulate_missing(pool: Pool, missing: Sequence[tuple[int, int]], killed: int) -> None:
        left = sum(end - first for first, end in missing)
        size = size_chunk(left, pool.workers, max(1, worker_pool.largest >> killed))
        _simulate_chunks(
            campaign, results, worker_pool, pool, divide_ranges(missing, size), progress
        )

    with Work(campaign, worker_pool, progress) as all_of_it:
        all_of_it.complete_missing(lambda _: results.list_missing(count), simulate_missing)


def _simulate_chunks(
    campaign: Campaign,
    results: Results,
    worker_pool: WorkerPool,
    pool: Pool,
    chunks: Iterable[tuple[int, int]],
    progress: CampaignProgress,
) -> None:
    """Work on chunks, two under way for each worker, until all are done or the time is over."""
    of_all = str(campaign.file.absolute()), campaign.key, str(results.folder.absolute())
    todo, waiting = iter(chunks), set[cf.Future[Done]]()
    while True:
        for first, end in itertools.islice(todo, max(0, 2 * pool.workers - len(waiting))):
            waiting.add(pool.submit(simulate_chunk, *of_all, first, end))
        if not waiting:
            return
        done, waiting = wait_for_any(pool, waiting)
        for future in done:
            progress.add_result(future.result())
        worker_pool.report(progress)
        if progress.is_late(campaign.stop.seconds):
            return


def size_chunk(runs: int, workers: int, largest: int) -> int:
    """Return the size of chunks that end with all workers busy, at least two for each."""
    rounds = max(2, math.ceil(runs / (largest * workers)))
    size = math.ceil(runs / (rounds * workers))
    return size if size < WIDTH else min(largest, size + -size % WIDTH)  # lanes are full


def list_stages(campaign: Campaign) -> Iterator[int]:
    """Yield the counts of runs after which a campaign may stop: the same however it is divided."""
    count = FIRST_STAGE
    while campaign.stop.width > 0.0 and count < campaign.count:
        yield count
        count = math.ceil(GROWTH * count)
    yield campaign.count


def count_failures(campaign: Campaign, columns: dict[str, NDArray[Any]], count: int) -> list[int]:
    """Return how often each requirement, and any of them last, failed in the first runs."""
    first = columns[INDEX] < count
    failed = [
        int(np.count_nonzero(~(columns[f"{ROBUSTNESS}{name}"][first] >= 0.0)))
        for name in campaign.requirements
    ]
    return [*failed, int(np.count_nonzero(columns[FAILED][first]))]


def may_stop(campaign: Campaign, results: Results, count: int) -> bool:
    """Return whether the shares of failures are known well enough from the first runs."""
    stop = campaign.stop
    if stop.width <= 0.0:
        return False
    failures = count_failures(campaign, results.collect_columns(), count)
    intervals = (stop.compute_interval(failed, count) for failed in failures)
    return all(high - low <= stop.width for low, high in intervals)


def measure_run(campaign: Campaign, device: str | None = None) -> tuple[float, float]:
    """Return the time of a run and that of a start [s], measured.

    It is the time of the processor, or beside a device that of the clock.
    """
    clock = time.process_time if device is None else time.perf_counter
    began = clock()
    # Machines on a device are not kept: a worker needs its memory.
    simulator = (
        get_simulator(str(campaign.file.absolute()), campaign.key)[1]
        if device is None
        else make_simulator(campaign, device)
    )
    some = draw_cases(campaign.variation, np.arange(simulator.width) % campaign.count)
    list(simulator.simulate_runs(some[:1]))
    ready, runs = clock(), 0
    while runs < 3 or clock() - ready < 0.2:
        runs += len(some)
        list(simulator.simulate_runs(some))
        if clock() - ready > 5.0:
            break
    return (clock() - ready) / runs, ready - began
