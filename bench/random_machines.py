"""The claims about order and energy, held against random machines that stick and meet limits.

    python -m bench.random_machines --count 500

The claims and the truth stand in oracles/random_machines.py.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from arm_emulator.build.library_cache import CACHE_VARIABLE
from arm_emulator.machine.schemes.known import LOCATING_SCHEMES, SCHEMES
from bench.measure import progress
from bench.pictures import COLOURS, new_figure, save
from oracles.random_machines import FALLS, Verdict, judge


def table(verdicts: list[Verdict]) -> Table:
    """Return how many machines meet each claim, by scheme."""
    out = Table("scheme", "machines", "with events", "events", "diverged", "error in order",
                "balance in order", "balanced at 1 us", "worst there")  # fmt: skip
    for scheme in SCHEMES:
        own = [verdict for verdict in verdicts if verdict.scheme == scheme]
        if not own:
            continue
        sound = [one for one in own if not one.note]
        figures = (
            len(own),
            sum(one.events > 0 for one in own),
            sum(one.events for one in own),
            len(own) - len(sound),
            sum(one.in_order for one in own),
            sum(one.balance_in_order for one in own),
            sum(one.balanced for one in own),
            f"{max((one.left[2] for one in sound), default=math.nan):.1e}",
        )
        out.add_row(scheme, *map(str, figures))
    return out


def draw(verdicts: list[Verdict], folder: Path) -> None:
    """Draw error over error and energy over energy, at a step and at its tenth."""
    figure = new_figure(10.0, 5.0)
    titles = ("largest error of position [rad or m]", "energy left over, of what was exchanged")
    for axes, title, pick in zip(figure.subplots(1, 2), titles, ("errors", "left"), strict=True):
        for scheme in SCHEMES:
            pairs = [getattr(one, pick)[:2] for one in verdicts if one.scheme == scheme]
            if not pairs:
                continue
            coarse, fine = np.array(pairs).T
            axes.loglog(coarse, fine, ".", color=COLOURS[scheme], label=scheme)
        ends = np.array(axes.get_xlim())
        axes.plot(ends, ends / 100.0, color="0.4", linewidth=0.8, label="second order")
        axes.plot(ends, ends / FALLS[2], "--", color="0.6", linewidth=0.8, label="bound for it")
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("at h = 0.1 / fastest rate")
        axes.set_ylabel("at h / 10")
        axes.legend(frameon=False)
    save(figure, folder, "random_machines")


def main() -> int:
    """Judge random machines; exit code 1 if a claim is broken."""
    parser = argparse.ArgumentParser(prog="bench.random_machines", description=__doc__)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0, help="of the first machine")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--scheme", action="append", choices=SCHEMES, help="may be repeated")
    parser.add_argument("--out", type=Path, default=Path("out/random_machines"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    schemes = tuple(arguments.scheme or LOCATING_SCHEMES)
    seeds = range(arguments.seed, arguments.seed + arguments.count)
    verdicts: list[Verdict] = []
    failed: list[str] = []  # that could not be judged
    console = Console()
    with (
        tempfile.TemporaryDirectory() as cache,  # of libraries that nobody needs again
        ProcessPoolExecutor(arguments.jobs, initializer=_begin, initargs=(cache,)) as pool,
        progress("random machines", len(seeds)) as done,
    ):
        waiting = {pool.submit(judge, seed, schemes): seed for seed in seeds}
        try:
            for judged in as_completed(waiting):
                if judged.exception():
                    failed.append(f"seed {waiting[judged]}: {judged.exception()!r}")
                else:
                    verdicts += judged.result()
                done(f"seed {waiting[judged]}")
                figures = json.dumps([asdict(one) for one in verdicts], indent=1)
                (arguments.out / "figures.json").write_text(figures)
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            console.print(f"ended early, {len(verdicts) // len(schemes)} machines are judged")
    verdicts.sort(key=lambda one: (one.seed, one.scheme))
    draw(verdicts, arguments.out)
    console.print(table(verdicts))
    broken = [
        one for one in verdicts if not (one.in_order and one.balance_in_order and one.balanced)
    ]
    for one in broken:
        console.print(one)
    for line in failed:
        console.print(line)
    return 1 if broken or failed else 0


def _begin(cache: str) -> None:
    os.environ[CACHE_VARIABLE] = cache
    # Of compilations; a refusal comes back as an exception. An interrupt is for the one who asked.
    sys.stderr = open(os.devnull, "w")
    signal.signal(signal.SIGINT, signal.SIG_IGN)


if __name__ == "__main__":
    sys.exit(main())
