"""Any serial arm, from its robot description alone: does it go where it is sent?

    python -m bench.any_arm [ROBOT ...] [--moves 100] [--out out/any_arm]

The claims and the truth stand in oracles/any_arm.py.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from bench.measure import progress
from oracles.any_arm import Outcome, arms, examine


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
    arrived = sum(sum(one.arrived.values()) for one in outcomes)
    moves = sum(sum(one.moves.values()) for one in outcomes)
    console.print(f"{arrived} of {moves} moves arrived within the predicted residual")
    sys.exit(arrived < 0.99 * moves)


def _report(console: Console, outcomes: list[Outcome]) -> None:
    table = Table(box=None, pad_edge=False)
    for column in ("arm", "joints", "50 mm", "300 mm", "median s", "worst s", "speed / limit"):
        table.add_column(column, justify="left" if column == "arm" else "right")
    for one in outcomes:
        if one.refused:
            continue
        cells = [
            f"{one.arrived.get(key, 0)}/{one.moves.get(key, 0)}" for key in ("50 mm", "300 mm")
        ]
        times = sorted(one.seconds) or [float("nan")]
        table.add_row(
            one.name,
            str(one.joints),
            *cells,
            f"{times[len(times) // 2]:.2f}",
            f"{times[-1]:.2f}",
            f"{one.peak_speed:.2f}",
        )
    console.print(table)
    for one in outcomes:
        for words in (one.refused, *one.failures):
            if words:
                console.print(f"{one.name}: {words}", markup=False)


if __name__ == "__main__":
    main()
