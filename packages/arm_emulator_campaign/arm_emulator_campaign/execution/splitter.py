"""A search by splitting, its repetitions shared by several processes."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from arm_emulator.extension.base import write_atomically
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.execution.searcher import write_findings
from arm_emulator_campaign.execution.worker import Done, load_same_campaign
from arm_emulator_campaign.execution.worker_pool import (
    CampaignProgress,
    Pool,
    Work,
    WorkerPool,
    iterate_completed,
)
from arm_emulator_campaign.results.parts import Results, compute_checksum
from arm_emulator_campaign.search.method import Finding
from arm_emulator_campaign.search.splitting import ForkOrigin, Splitting, SplittingRepetition
from arm_emulator_campaign.simulation.forking import ForkingRun

FOLDER = "splitting"
PILOT = 0
LISTED = 10  # failures


class Splitter:
    """Takes a search by splitting to its end.

    A repetition is a function of the campaign and its number. Each is a file in the results, so
    that a search that was interrupted continues with those that are missing.

    Args:
        campaign: with a search by `Splitting`.
        results: where to.
        worker_pool: does it; its report is called after each repetition.
    """

    def __init__(self, campaign: Campaign, results: Results, worker_pool: WorkerPool) -> None:
        assert isinstance(campaign.search, Splitting)
        self._campaign, self._method, self._results = campaign, campaign.search, results
        self._worker_pool = worker_pool
        self._folder = results.folder / FOLDER
        self._folder.mkdir(exist_ok=True)
        count = self._method.count_runs(len(campaign.variation.numbers))
        self._progress = CampaignProgress(count, 0, failures=[0] * (len(campaign.requirements) + 1))

    def run_search(self) -> list[Finding]:
        """Search to the end; return what was found, which is written beside the results, too.

        Raises:
            Refusal: a run that is not taken, or workers that end again and again.
            KeyboardInterrupt: after what was done has been written.
        """
        ForkingRun.check_campaign(self._campaign)
        self._complete_repetitions([PILOT])
        key = self._campaign.key
        pilot = _read_content(_name_file(self._folder, PILOT), key)
        repetitions: list[SplittingRepetition] = []
        if pilot["leads"]:
            numbers = range(1, 1 + int(self._method.repetitions))
            self._complete_repetitions(list(numbers))
            repetitions = [
                _read_repetition(_name_file(self._folder, number), key) for number in numbers
            ]
        findings = [self._method.make_finding(self._method.of, pilot["levels"], repetitions)]
        if repetitions:
            findings.append(self._method.list_levels(pilot["levels"], repetitions))
            findings.append(self._list_first_failures(_list_failures(repetitions)))
        write_findings(self._results, findings)
        return findings

    def _list_first_failures(self, failures: Sequence[ForkOrigin]) -> Finding:
        """Return the first failures, by the numbers that the command line takes."""
        period = self._campaign.scene.servo_period
        rows = []
        for k, failure in enumerate(failures[:LISTED]):
            forks = [tick * period for tick, _ in failure.seeds[1:]]
            rows.append((k, failure.index, len(forks), max(forks, default=0.0)))
        about = (
            f"{len(failures)} runs failed, numbers 0 to {len(failures) - 1} of `--replay` and "
            "`--shrink`. The first ones:"
            if failures
            else "No run failed."
        )
        head = "failure", "values of run", "forks", "last fork [s]"
        return Finding("Failures", about, head, tuple(rows))

    def _is_done(self, number: int) -> bool:
        """Return whether a repetition is there as it was written; a damaged file is set aside."""
        file = _name_file(self._folder, number)
        if not file.exists():
            return False
        try:
            _read_content(file, self._campaign.key)
        except ValueError as error:
            return self._results.set_aside(file, str(error))
        return True

    def _complete_repetitions(self, numbers: list[int]) -> None:
        """Have the repetitions done that are not."""
        of_all = str(self._campaign.file.absolute()), self._campaign.key, str(self._folder)

        def list_missing(_: int) -> list[int]:
            return [number for number in numbers if not self._is_done(number)]

        def run_missing(pool: Pool, left: Sequence[int], _: int) -> None:
            futures = [pool.submit(run_repetition, *of_all, k) for k in left]
            for future in iterate_completed(pool, futures):
                self._progress.add_result(future.result())
                self._worker_pool.report(self._progress)

        with Work(self._campaign, self._worker_pool, self._progress) as repetitions:
            repetitions.complete_missing(list_missing, run_missing)


def read_failures(results: Results) -> list[ForkOrigin]:
    """Return the failures of all repetitions that are done, in their order."""
    files = sorted((results.folder / FOLDER).glob("[0-9]*.json"))
    repetitions = []
    for file in files:
        try:
            repetitions.append(_read_repetition(file, results.campaign.key))
        except ValueError as error:
            results.set_aside(file, str(error))
    return _list_failures(repetitions)


def _list_failures(repetitions: Iterable[SplittingRepetition]) -> list[ForkOrigin]:
    return [failure for repetition in repetitions for failure in repetition.failures]


def run_repetition(file: str, key: bytes, folder: str, number: int) -> Done:
    """Do a repetition, or the pilot, and write its file."""
    campaign, began = load_same_campaign(file, key), time.process_time()
    method, seed = campaign.search, int.from_bytes(campaign.key[16:24])
    assert isinstance(method, Splitting)
    run = ForkingRun(campaign)
    if number == PILOT:
        levels, leads = method.run_pilot(run, seed)
        content: dict[str, object] = {"levels": levels, "leads": leads}
        runs = int(method.per_level) * (len(levels) + 1)
    else:
        levels = _read_content(_name_file(Path(folder), PILOT), key)["levels"]
        repetition = method.run_repetition(run, levels, seed, number)
        content, runs = asdict(repetition), repetition.runs
    text = json.dumps(content)
    head = {"key": key.hex(), "checksum": compute_checksum(text.encode()), "content": text}
    write_atomically(_name_file(Path(folder), number), json.dumps(head))
    nothing = (0,) * (len(campaign.requirements) + 1)
    return Done(runs, nothing, time.process_time() - began, True)


def _read_content(file: Path, key: bytes) -> dict[str, Any]:
    """Return what a file of a repetition, or of the pilot, has.

    Raises:
        ValueError: it is damaged, or of another campaign.
    """
    head = json.loads(file.read_text(encoding="utf-8"))
    text = head.get("content") if isinstance(head, dict) else None
    if not isinstance(text, str) or head.get("checksum") != compute_checksum(text.encode()):
        raise ValueError("its bytes are not those that were written")
    if head.get("key") != key.hex():
        raise ValueError("it is of another campaign")
    content: dict[str, Any] = json.loads(text)
    return content


def _read_repetition(file: Path, key: bytes) -> SplittingRepetition:
    data = _read_content(file, key)
    return SplittingRepetition(
        **data | {"failures": [ForkOrigin(**origin) for origin in data["failures"]]}
    )


def _name_file(folder: Path, number: int) -> Path:
    return folder / ("pilot.json" if number == PILOT else f"{number:04d}.json")
