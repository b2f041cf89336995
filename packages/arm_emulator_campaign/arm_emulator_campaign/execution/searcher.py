"""A search by several processes: batches of runs, each chosen from the margins of those before."""

from __future__ import annotations

import concurrent.futures as cf
import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import Array, Refusal, write_atomically
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.execution.executor import count_failures
from arm_emulator_campaign.execution.worker import Done, simulate_chunk
from arm_emulator_campaign.execution.worker_pool import (
    CampaignProgress,
    Pool,
    Work,
    WorkerPool,
    iterate_completed,
)
from arm_emulator_campaign.results.parts import INDEX, MEASURE, ROBUSTNESS, Results, divide_ranges
from arm_emulator_campaign.search.method import Finding

FINDINGS = "search.json"
ANY = "any requirement"


def write_findings(results: Results, findings: Sequence[Finding]) -> None:
    """Write what a search has found beside the results."""
    write_atomically(
        results.folder / FINDINGS, json.dumps([asdict(finding) for finding in findings], indent=1)
    )


class Searcher:
    """Takes a campaign's search through its course.

    Its batches depend on nothing but the campaign. What is among the results already is not
    simulated again, so that a search that was interrupted goes on where it was.

    Args:
        campaign: with a search.
        results: where to.
        worker_pool: simulates; the workers of its pool share a batch.
    """

    def __init__(self, campaign: Campaign, results: Results, worker_pool: WorkerPool) -> None:
        assert campaign.search is not None
        self._campaign, self._results, self._method = campaign, results, campaign.search
        self._worker_pool = worker_pool
        self._outputs = [f"{ROBUSTNESS}{name}" for name in campaign.requirements]
        self._outputs += [f"{MEASURE}{name}" for name in campaign.measures]
        self._varying = [number.name for number in campaign.variation.numbers]
        self._next = 0
        columns = self._read_results()
        failures = count_failures(campaign, columns, 2**62)
        count = self._method.count_runs(len(self._varying))
        self._progress = CampaignProgress(count, len(self._place_of_run), failures=failures)
        self._work = Work(campaign, worker_pool, self._progress)

    def run_search(self) -> list[Finding]:
        """Search to the end; return what was found, which is written beside the results, too.

        Raises:
            Refusal: a run that is not taken, or workers that end again and again.
            KeyboardInterrupt: after what was done has been written.
        """
        requirements, seed = self._campaign.requirements, int.from_bytes(self._campaign.key[16:24])
        names = self._outputs if self._method.every else [self._method.of or ANY]
        names = [name.removeprefix(ROBUSTNESS) for name in names]
        sampler = self._method.make_sampler(self._varying, names, seed)
        try:
            points = next(sampler)
            while True:
                outputs = self._run_batch(points)
                if not self._method.every:
                    of = [*requirements].index(self._method.of) if self._method.of else None
                    margins = outputs[:, : len(requirements)]
                    outputs = (margins.min(axis=1) if of is None else margins[:, of])[:, None]
                points = sampler.send(outputs)
        except StopIteration as end:
            findings: list[Finding] = end.value
        finally:
            self._work.end_processes()
        write_findings(self._results, findings)
        return findings

    def _read_results(self) -> dict[str, NDArray[Any]]:
        """Take the runs that are done from the results, and return their columns."""
        columns = self._results.collect_columns()
        self._place_of_run = {int(index): place for place, index in enumerate(columns[INDEX])}
        self._values = np.column_stack([columns[name] for name in self._varying])
        self._stored_outputs = np.column_stack([columns[name] for name in self._outputs])
        return columns

    def _run_batch(self, points: Array) -> Array:
        """Return the outputs of the runs at some points (K, M)."""
        first, self._next = self._next, self._next + len(points)
        outputs = np.full((len(points), len(self._outputs)), math.nan)

        def list_missing(killed: int) -> list[tuple[int, int]]:
            if killed:
                self._read_results()
            return self._fill_outputs(first, points, outputs)

        def simulate_missing(pool: Pool, left: Sequence[tuple[int, int]], _: int) -> None:
            self._simulate_missing(pool, first, points, left, outputs)

        self._work.complete_missing(list_missing, simulate_missing)
        return outputs

    def _fill_outputs(self, first: int, points: Array, outputs: Array) -> list[tuple[int, int]]:
        """Fill in outputs that are known; return the runs that are missing, as ranges."""
        gaps: list[tuple[int, int]] = []
        values = self._campaign.variation.place_values(points)
        for k in range(len(points)):
            index = first + k
            place = self._place_of_run.get(index)
            if place is None:
                begin = gaps.pop()[0] if gaps and gaps[-1][1] == index else index
                gaps.append((begin, index + 1))
                continue
            if not np.array_equal(self._values[place], values[k]):
                rule = "have runs of this search, by the same versions of its packages"
                folder = f"folder {self._results.folder}"
                raise Refusal("campaign", folder, rule, f"another run {index}", "--into FOLDER")
            outputs[k] = self._stored_outputs[place]
        return gaps

    def _simulate_missing(
        self,
        pool: Pool,
        first: int,
        points: Array,
        missing: Sequence[tuple[int, int]],
        outputs: Array,
    ) -> None:
        """Simulate what is missing of a batch."""
        campaign, folder = self._campaign, str(self._results.folder.absolute())
        left = sum(end - begin for begin, end in missing)
        size = max(1, min(self._worker_pool.largest, math.ceil(left / pool.workers)))
        waiting: dict[cf.Future[Done], int] = {}
        for begin, end in divide_ranges(missing, size):
            rows = points[begin - first : end - first]
            chunk = str(campaign.file.absolute()), campaign.key, folder, begin, end, rows
            waiting[pool.submit(simulate_chunk, *chunk)] = begin
        for future in iterate_completed(pool, waiting):
            done = future.result()
            at = waiting[future] - first
            assert done.outputs is not None
            outputs[at : at + done.runs] = done.outputs
            self._progress.add_result(done)
            self._worker_pool.report(self._progress)
