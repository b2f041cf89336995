"""Any serial arm, from its robot description alone: does it go where it is sent, and how?

    python -m bench.any_arm [ROBOT ...] [--moves 100] [--out out/any_arm]

The claims and the truth stand in oracles/any_arm.py.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from bench.measure import progress
from oracles.any_arm import DISTANCES_NAMED, Move, Outcome, arms, examine


def main() -> None:
    """Print a row per arm; exit code 1 if fewer than 99 % of all moves arrived."""
    parser = argparse.ArgumentParser(prog="bench.any_arm", description=__doc__.splitlines()[0])
    parser.add_argument("robots", nargs="*", help="names, or parts of them, or files")
    parser.add_argument("--moves", type=int, default=100, help="of each distance")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path, default=Path("out/any_arm"))
    arguments = parser.parse_args()
    chosen = arms()
    if arguments.robots:
        files = {Path(one).stem: Path(one) for one in arguments.robots if Path(one).is_file()}
        named = [one for one in arguments.robots if not Path(one).is_file()]
        chosen = {n: r for n, r in chosen.items() if any(one in n for one in named)}
        chosen.update(files)
    console = Console(highlight=False)
    outcomes: list[Outcome] = []
    with ProcessPoolExecutor(arguments.jobs) as pool, progress("arms", len(chosen)) as tick:
        began = time.monotonic()
        jobs = [pool.submit(examine, n, r, arguments.moves) for n, r in chosen.items()]
        for job in as_completed(jobs):
            outcomes.append(job.result())
            tick(outcomes[-1].name)
    outcomes.sort(key=lambda one: one.name)
    _report(console, outcomes)
    arguments.out.mkdir(parents=True, exist_ok=True)
    file = arguments.out / "any_arm.json"
    file.write_text(json.dumps([asdict(one) for one in outcomes], indent=1), encoding="utf-8")
    console.print(f"{time.monotonic() - began:.0f} s, all failures are in {file}")
    moves = [one for outcome in outcomes for one in outcome.moves]
    arrived = sum(not one.words for one in moves)
    console.print(f"{arrived} of {len(moves)} moves arrived within the predicted residual")
    for distance in dict.fromkeys(one.distance for one in moves):
        console.print(summary(distance, [one for one in moves if one.distance == distance]))
    sys.exit(arrived < 0.99 * len(moves))


def summary(distance: str, moves: list[Move]) -> str:
    """Return in a line what the tools did on the way of all moves of a distance."""
    past = [max(0.0, one.past) * 1e3 for one in moves]
    straight = [one for one in moves if "tool's line" in one.way]
    off = sum(one.aside > max(1e-3, 1e-2 * one.length) for one in straight)
    fast = sum(one.peak_speed > 1.0 for one in moves)
    median = statistics.median(one.seconds for one in moves)
    return (
        f"{distance}: {sum(one.overshot for one in moves)} of {len(moves)} past their rest by more "
        f"than 1 mm and 0.5 %, {sum(one > 5.0 for one in past)} by more than 5 mm, worst "
        f"{max(past):.2f} mm; {off} of {len(straight)} on the tool's line off it by more than "
        f"1 mm and 1 %; {fast} faster than their limits; median {median:.2f} s"
    )


def _report(console: Console, outcomes: list[Outcome]) -> None:
    table = Table(box=None, pad_edge=False)
    columns = ("arm", "joints", *DISTANCES_NAMED, "median s", "worst s", "past mm", "speed / limit")
    for column in columns:
        table.add_column(column, justify="left" if column == "arm" else "right")
    for one in outcomes:
        if one.refused or not one.moves:
            continue
        cells = [
            f"{sum(not m.words for m in one.of(key))}/{len(one.of(key))}" for key in DISTANCES_NAMED
        ]
        times = [m.seconds for m in one.arrived] or [float("nan")]
        table.add_row(
            one.name,
            str(one.joints),
            *cells,
            f"{statistics.median(times):.2f}",
            f"{max(times):.2f}",
            f"{max(m.past for m in one.moves) * 1e3:.2f}",
            f"{max(m.peak_speed for m in one.moves):.2f}",
        )
    console.print(table)
    for one in outcomes:
        failures = [f"{move.distance}: {move.words}" for move in one.moves if move.words]
        for words in [one.refused] if one.refused else failures:
            console.print(f"{one.name}: {words}", markup=False)


if __name__ == "__main__":
    main()
