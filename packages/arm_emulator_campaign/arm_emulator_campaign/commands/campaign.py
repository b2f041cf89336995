"""Simulate many varied runs of one scenario, and count how often its requirements fail."""

from __future__ import annotations

import dataclasses
import itertools
import math
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.extension.base import KEEP_NOTHING, Refusal, check_count, print_warnings
from arm_emulator.extension.commands import Keep, PageAt, check_new_bag, command, output
from arm_emulator.extension.compiler import ARITHMETIC
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.execution.executor import measure_run, run_campaign
from arm_emulator_campaign.execution.searcher import Searcher
from arm_emulator_campaign.execution.splitter import Splitter
from arm_emulator_campaign.execution.worker_pool import (
    CampaignProgress,
    DaskPool,
    LocalPool,
    Pool,
    WorkerPool,
)
from arm_emulator_campaign.judging.evaluators import find_start_requirements
from arm_emulator_campaign.results.parts import Results, compute_digest, list_column_units
from arm_emulator_campaign.results.report import write_report
from arm_emulator_campaign.results.summary import Summary, compute_summary
from arm_emulator_campaign.search.method import Finding
from arm_emulator_campaign.single_cases import find_case, print_shrunk, replay_run

PATIENCE = 10.0  # s that a Dask scheduler may take to answer
BYTES_PER_NUMBER = 9.0  # of a part, measured: doubles of random bits hardly shrink


@command(
    keys=(
        "`count`, `per_run`, `estimate` (s of all runs), `bytes`; after the runs `shares`, "
        "`quantiles`, `confidence`, `digest`, `results`, `arithmetic`; with the option "
        "replay `index`, `values`, `robustness`, `measures`, `failed`, `missed`; with shrink "
        "`index`, `requirement`, `changes`, `faults`, `seconds`, `margin`, `runs`, `campaign`"
    ),
)
def execute_campaign(
    file: Annotated[Path, Parameter(metavar="FILE")],
    /,
    *,
    into: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
    count: Annotated[int | None, Parameter(metavar="N")] = None,
    workers: Annotated[int | None, Parameter(metavar="N")] = None,
    dask: Annotated[str | None, Parameter(metavar="ADDRESS")] = None,
    device: Annotated[str | None, Parameter(metavar="DEVICE")] = None,
    dry: bool = False,
    replay: Annotated[int | None, Parameter(metavar="INDEX")] = None,
    shrink: Annotated[int | None, Parameter(metavar="INDEX")] = None,
    page: PageAt = None,
    bag: Path | None = None,
    outputs: Keep = KEEP_NOTHING,
) -> int:
    """Simulate the runs of a campaign and report how often its requirements fail.

    The exit code is 1 where the only run, or that of --replay, fails a requirement, and where no
    run was simulated. Ctrl-C keeps all that is done; the same command goes on with what is missing.

    Args:
        file: the campaign, YAML.
        into: results and report (default: out/campaigns/NAME).
        count: runs in all, in the place of the file's count.
        workers: processes (default: one for each processor core, or all threads of the cluster).
        dask: scheduler of a Dask cluster, whose workers see the same files.
        device: where the arms are: gpu (the first card of NVIDIA), gpu:0,gpu:1 (a worker for each),
            or processor, on which the kernels of cards run as loops.
        dry: measure what a run costs, print time and size of the whole, and simulate nothing more.
        replay: simulate one run again, for --record, --bag, --rerun and --page.
        shrink: find the fewest changes and the shortest time with which a run still fails; write
            them into the folder of the results as a campaign.
        bag: new bag with the run of --replay and its scene; needs ROS 2.
    """
    outputs.check_options("campaign")
    if (outputs != KEEP_NOTHING or page is not None or bag is not None) and replay is None:
        rule = "come with --replay INDEX, which names the run"
        raise Refusal("campaign", "--record, --bag, --rerun and --page", rule, "no --replay")
    if bag is not None:
        check_new_bag("campaign", bag)
    definition = load_campaign(file)
    if definition.search is not None and count is not None:
        raise Refusal(
            "campaign", "--count", "be absent together with search, which counts its runs", count
        )
    if count is not None:
        definition = dataclasses.replace(
            definition, count=check_count("campaign", "--count", count, 1, 10**12)
        )
    if workers is not None:
        check_count("campaign", "--workers", workers, 1, 100_000 if dask else 4096)
    devices = _read_devices(definition, device, dask, workers, [replay, shrink])
    into = into or Path("out") / "campaigns" / file.stem
    if replay is not None:
        return replay_run(
            definition, find_case(definition, into, replay, "--replay"), outputs, page, bag
        )
    if shrink is not None:
        return print_shrunk(definition, find_case(definition, into, shrink, "--shrink"), into)
    for text in find_start_requirements(definition):
        print_warnings(text)
    seconds, ready = measure_run(definition, *devices[:1])
    at_hand = len(devices) if devices and dask is None else workers or _count_workers(dask)
    _print_cost(definition, seconds, ready, at_hand)
    if dry:
        return 0
    results = Results(into, definition)
    interrupted, findings = _simulate_missing(definition, results, dask, workers, devices, seconds)
    columns = results.collect_columns()
    summary = compute_summary(definition, columns)
    if definition.search is None:
        _print_summary(summary, compute_digest(columns), results.folder)
    else:
        print_findings(findings, compute_digest(columns), summary.count, results.folder)
    if summary.count or findings:
        output.print_line(
            f"report  {write_report(definition, results, columns, summary, findings)}"
        )
    if interrupted:
        output.print_line("interrupted: the same command goes on with what is missing")
        return 130
    fails = [share.name for share in summary.shares if share.hits and summary.count == 1]
    missed = f"the only run fails {', '.join(fails)}" if fails and definition.search is None else ""
    if not summary.count and not findings:
        missed = "it has ended before the first run"
    return output.report_miss("campaign", missed)


def _read_devices(
    definition: Campaign,
    device: str | None,
    dask: str | None,
    workers: int | None,
    single: Sequence[int | None],
) -> list[str]:
    """Return the devices of the option, none for lanes of the processor.

    Raises:
        Refusal: a campaign or other options that no device serves.
    """
    if device is None:
        return []
    where, devices = "campaign", device.split(",")
    if single != [None] * len(single):
        rule = "be absent with --replay and --shrink, which simulate one run at a time"
        raise Refusal(where, "--device", rule, device)
    if definition.search is not None and definition.search.forks:
        rule = "be absent with a search that splits runs, which are forked one by one"
        raise Refusal(where, "--device", rule, device)
    if len(set(devices)) < len(devices):
        raise Refusal(where, "--device", "name each device once", device)
    if dask is not None and len(devices) > 1:
        valid = "gpu, with CUDA_VISIBLE_DEVICES for each worker"
        raise Refusal(where, "--device", "be one with --dask", device, valid)
    if dask is None and workers is not None:
        raise Refusal(where, "--workers", "be absent with --device, a worker for each", workers)
    return devices


def _count_workers(dask: str | None) -> int:
    """Return the number of workers that are at hand."""
    if dask is None:
        return len(os.sched_getaffinity(0))
    cluster = DaskPool(dask, PATIENCE)
    try:
        return cluster.workers
    finally:
        cluster.end_workers()


def _print_cost(definition: Campaign, seconds: float, ready: float, workers: int) -> None:
    scenario = definition.nominal[0]
    bound = "" if definition.search is None else "at most "
    count = (
        definition.count
        if definition.search is None
        else definition.search.count_runs(len(definition.variation.numbers))
    )
    size = count * len(list_column_units(definition)) * BYTES_PER_NUMBER
    wall = count * seconds / workers + ready
    output.add_facts({"count": count, "per_run": seconds, "estimate": wall, "bytes": size})
    output.print_line(
        f"campaign {definition.file.name}: {bound}{count} runs of {scenario.seconds:g} s of "
        f"{definition.scene.name}, {len(definition.variation.numbers)} numbers vary, "
        f"{len(definition.requirements)} requirements"
    )
    output.print_line(
        f"a run takes {_format_time(seconds)} ({scenario.seconds / seconds:.0f} times real time); "
        f"all with {workers} workers {bound}{_format_time(wall)}, {_format_bytes(size)}"
    )


def _simulate_missing(
    definition: Campaign,
    results: Results,
    dask: str | None,
    workers: int | None,
    devices: Sequence[str],
    seconds: float,
) -> tuple[bool, list[Finding]]:
    """Simulate what is missing; return whether Ctrl-C has ended it, and what a search found."""
    # One that was killed may take its time to be there again.
    patience = itertools.chain([PATIENCE], itertools.repeat(60.0))

    def open_pool() -> Pool:
        if dask is None:
            return LocalPool(len(devices) or workers or _count_workers(dask), devices)
        return DaskPool(dask, next(patience), workers, *devices)

    with _show_progress() as report:
        worker_pool = WorkerPool(open_pool, seconds, report)
        try:
            if definition.search is not None and definition.search.forks:
                return False, Splitter(definition, results, worker_pool).run_search()
            if definition.search is not None:
                return False, Searcher(definition, results, worker_pool).run_search()
            run_campaign(definition, results, worker_pool)
        except KeyboardInterrupt:
            return True, []
    return False, []


@contextmanager
def _show_progress() -> Iterator[Callable[[CampaignProgress], None]]:
    """Within, the progress is shown: a bar in a terminal, else a line now and then."""
    console = output.make_console()
    if not console.is_terminal:
        yield _print_progress()
        return
    from rich.progress import BarColumn, TextColumn
    from rich.progress import Progress as Bar

    columns = "{task.completed}/{task.total} runs", "{task.fields[facts]}"
    with Bar(BarColumn(), *map(TextColumn, columns), console=console, transient=True) as bar:
        task = bar.add_task("", facts="")

        def update_bar(now: CampaignProgress) -> None:
            done = now.before + now.done
            bar.update(task, total=now.count, completed=done, facts=_format_progress(now))

        yield update_bar


def _print_progress() -> Callable[[CampaignProgress], None]:
    last = [time.monotonic()]

    def print_line(now: CampaignProgress) -> None:
        if time.monotonic() - last[0] >= 10.0:
            last[0] = time.monotonic()
            output.print_line(
                f"{now.before + now.done} of {now.count} runs, {_format_progress(now)}"
            )

    return print_line


def _format_progress(now: CampaignProgress) -> str:
    left = f"{_format_time(now.left)} left" if math.isfinite(now.left) else "time left unknown"
    return f"{now.rate:.0f} runs/s, {now.failures[-1]} failed, {left}"


def _print_summary(summary: Summary, digest: str, folder: Path) -> None:
    percent = f"{100 * summary.confidence:g} %"
    for share in summary.shares if summary.count else ():
        output.print_line(
            f"{share.name:<20} fails in {share.hits} of {summary.count}: "
            f"{100 * share.share:.4g} %, within "
            f"{100 * share.low:.4g} and {100 * share.high:.4g} % ({percent} confidence)"
        )
    output.print_line(f"digest  {digest}")
    output.add_facts({
        "count": summary.count, "shares": summary.shares, "quantiles": summary.quantiles,
        "confidence": summary.confidence, "digest": digest, "results": str(folder),
        "arithmetic": ARITHMETIC,
    })  # fmt: skip


def _format_time(seconds: float) -> str:
    if seconds < 1.0:
        return f"{1e3 * seconds:.3g} ms"
    if seconds < 120.0:
        return f"{seconds:.3g} s"
    return f"{seconds / 60:.3g} min" if seconds < 7200.0 else f"{seconds / 3600:.3g} h"


def _format_bytes(size: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000.0:
            return f"{size:.3g} {unit}"
        size /= 1000.0
    return f"{size:.3g} TB"


def print_findings(findings: Sequence[Finding], digest: str, count: int, folder: Path) -> None:
    """Print what a search found."""
    for finding in findings:
        output.print_line(finding.about)
        if finding.rows:
            output.print_table(finding.head, finding.format_rows(), left=len(finding.head))
    output.print_line(f"digest  {digest}")
    output.add_facts({
        "findings": [asdict(finding) for finding in findings], "count": count, "digest": digest,
        "results": str(folder),
    })  # fmt: skip
