"""Every scene at rest without a command, in random poses, with each law of friction alone.

    python -m bench.at_rest --poses 2000

The claims and the truth stand in oracles/at_rest.py.
"""

from __future__ import annotations

import argparse
import sys

from rich.console import Console
from rich.table import Table

from arm_emulator.machine.schemes.known import SCHEMES
from bench.measure import progress
from oracles.at_rest import SHIPPED, Case, cases, equations_of, judge


def main(arguments: list[str] | None = None) -> int:
    """Judge all cases; exit code 1 if any is broken."""
    parser = argparse.ArgumentParser(prog="bench.at_rest", description=__doc__)
    parser.add_argument("--poses", type=int, default=2000, help="of each case")
    parser.add_argument("--scene", action="append", choices=SHIPPED, help="may be repeated")
    parser.add_argument("--scheme", action="append", choices=SCHEMES, help="may be repeated")
    options = parser.parse_args(arguments)
    scenes = tuple(options.scene or SHIPPED)
    equations = {name: equations_of(name) for name in scenes}
    todo = cases(scenes, tuple(options.scheme or SCHEMES))
    wrong: dict[Case, list[str]] = {}
    with progress("at rest", len(todo)) as done:
        for case in todo:
            wrong[case] = judge(case, options.poses, equations[case.scene])
            done(f"{case.scene} {case.place} {case.law} {case.scheme} {case.events}")
    table = Table("scene", "cases", "poses of each", "poses that are wrong")
    for name in scenes:
        own = [lines for case, lines in wrong.items() if case.scene == name]
        table.add_row(name, str(len(own)), str(options.poses), str(sum(map(len, own))))
    Console().print(table)
    for lines in wrong.values():
        print(*lines[:3], sep="\n", end="\n" if lines else "")
    return 1 if any(wrong.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
