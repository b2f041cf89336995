"""`arm_emulator campaign`: runs, their progress, their report."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from arm_emulator.base.count import check_count
from arm_emulator.base.kept import NOTHING, Kept
from arm_emulator.base.refusal import Refusal
from arm_emulator.campaign.campaign_file import Campaign, load_campaign
from arm_emulator.campaign.executor import (
    DaskPool,
    LocalPool,
    Pool,
    Progress,
    run_campaign,
    seconds_per_run,
)
from arm_emulator.campaign.report import write_report
from arm_emulator.campaign.results import Results, column_units, digest_of
from arm_emulator.campaign.simulator import Simulator
from arm_emulator.campaign.summary import Summary, summary_of
from arm_emulator.cli.output import Output
from arm_emulator.machine.diverged import Diverged
from arm_emulator.runs.recorder import Recorder

BYTES_PER_NUMBER = 9.0  # of a part, measured: doubles of random bits hardly shrink


class Options(NamedTuple):
    """Arguments of the command line, see `commands.campaign`."""

    into: Path | None
    runs: int | None
    workers: int | None
    dask: str | None
    dry: bool
    replay: int | None
    kept: Kept


def campaign(file: Path, options: Options, *, json: bool = False) -> int:
    """Do what the command line states; return the exit code.

    Raises:
        Refusal: a file, folder or option that is not taken.
    """
    options.kept.check("campaign")
    if options.kept != NOTHING and options.replay is None:
        rule = "come with --replay INDEX, which names the run"
        raise Refusal("campaign", "--record and --rerun", rule, "no --replay")
    output = Output(json)
    one = load_campaign(file)
    if options.runs is not None:
        count = check_count("campaign", "--count", options.runs, 1, 10**12)
        one = replace(one, count=count)
    cores = len(os.sched_getaffinity(0))
    workers = cores if options.workers is None else options.workers
    check_count("campaign", "--workers", workers, 1, 4096)
    if options.replay is not None:
        return _replay(one, options.replay, options.kept, output)
    seconds, ready = seconds_per_run(one)
    _preview(one, seconds, ready, workers, output)
    if options.dry:
        return 0
    results = Results(options.into or Path("out") / "campaigns" / file.stem, one)
    interrupted = _simulate(one, results, options, workers, seconds, output)
    columns = results.columns()
    summary = summary_of(one, columns)
    _print(summary, digest_of(columns), results.folder, output)
    if summary.count:
        output.line(f"report  {write_report(one, results, columns, summary)}")
    if interrupted:
        output.line("interrupted: the same command goes on with what is missing")
    return 130 if interrupted else 0


def _preview(one: Campaign, seconds: float, ready: float, workers: int, output: Output) -> None:
    scenario = one.nominal[0]
    size = one.count * len(column_units(one)) * BYTES_PER_NUMBER
    wall = one.count * seconds / workers + ready
    output.line(
        f"campaign {one.file.name}: {one.count} runs of {scenario.seconds:g} s of "
        f"{one.scene.name}, {len(one.variation.numbers)} numbers vary, "
        f"{len(one.requirements)} requirements"
    )
    output.line(
        f"a run takes {_time(seconds)} ({scenario.seconds / seconds:.0f} times real time); "
        f"all with {workers} workers {_time(wall)}, {_bytes(size)}"
    )


def _simulate(
    one: Campaign,
    results: Results,
    options: Options,
    workers: int,
    seconds: float,
    output: Output,
) -> bool:
    """Simulate what is missing; return whether Ctrl-C has ended it."""

    def pool() -> Pool:
        return DaskPool(options.dask) if options.dask else LocalPool(workers)

    with _shown(output) as report:
        try:
            run_campaign(one, results, pool, workers, seconds, report)
        except KeyboardInterrupt:
            return True
    return False


@contextmanager
def _shown(output: Output) -> Iterator[Callable[[Progress], None]]:
    """Within, the progress is shown: a bar in a terminal, else a line now and then."""
    console = output.console()
    if not console.is_terminal:
        yield _lines(output)
        return
    from rich.progress import BarColumn, TextColumn
    from rich.progress import Progress as Bar

    columns = "{task.completed}/{task.total} runs", "{task.fields[facts]}"
    with Bar(BarColumn(), *map(TextColumn, columns), console=console, transient=True) as bar:
        task = bar.add_task("", facts="")

        def show(now: Progress) -> None:
            done = now.before + now.done
            bar.update(task, total=now.count, completed=done, facts=_facts(now))

        yield show


def _lines(output: Output) -> Callable[[Progress], None]:
    last = [time.monotonic()]

    def show(now: Progress) -> None:
        if time.monotonic() - last[0] >= 10.0:
            last[0] = time.monotonic()
            output.line(f"{now.before + now.done} of {now.count} runs, {_facts(now)}")

    return show


def _facts(now: Progress) -> str:
    left = f"{_time(now.left)} left" if math.isfinite(now.left) else "time left unknown"
    return f"{now.rate:.0f} runs/s, {now.failures[-1]} failed, {left}"


def _print(summary: Summary, digest: str, folder: Path, output: Output) -> None:
    percent = f"{100 * summary.confidence:g} %"
    for one in summary.shares:
        output.line(
            f"{one.name:<20} fails in {one.hits} of {summary.count}: {100 * one.share:.4g} %, "
            f"within {100 * one.low:.4g} and {100 * one.high:.4g} % ({percent} confidence)"
        )
    output.line(f"digest  {digest}")
    output.facts({
        "count": summary.count, "shares": summary.shares, "quantiles": summary.quantiles,
        "confidence": summary.confidence, "digest": digest, "results": str(folder),
    })  # fmt: skip


def _replay(one: Campaign, index: int, kept: Kept, output: Output) -> int:
    """Simulate a run again: judged as in the campaign, then once more for who records it."""
    check_count("campaign", "--replay", index, 0, 10**12)
    simulator = Simulator(one)
    outcome = simulator.run(index)
    for name, value in outcome.values.items():
        output.line(f"{name:<44} {value!r}")
    for name, value in outcome.robustness.items():
        output.line(f"{name:<44} {'holds' if value >= 0.0 else 'FAILS'} by {abs(value):.6g}")
    for name, value in outcome.measures.items():
        output.line(f"{name:<44} {value:.6g}")
    output.facts({
        "index": index, "values": outcome.values, "robustness": outcome.robustness,
        "measures": outcome.measures, "failed": outcome.failed,
    })  # fmt: skip
    if kept != NOTHING:
        pieces = simulator.drive(index)
        next(pieces)
        with Recorder(simulator.session.plant, kept, waits=True, stays=True):
            try:
                for _ in pieces:
                    pass
            except Diverged as fault:
                output.line(str(fault))
    return 0


def _time(seconds: float) -> str:
    if seconds < 1.0:
        return f"{1e3 * seconds:.3g} ms"
    if seconds < 120.0:
        return f"{seconds:.3g} s"
    return f"{seconds / 60:.3g} min" if seconds < 7200.0 else f"{seconds / 3600:.3g} h"


def _bytes(size: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000.0:
            return f"{size:.3g} {unit}"
        size /= 1000.0
    return f"{size:.3g} TB"
