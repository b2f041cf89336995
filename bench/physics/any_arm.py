"""Any serial arm, from its robot description alone: does it go where it is sent, and how?

    python -m bench.physics.any_arm [ROBOT ...] [--moves 30] [--out out/any_arm.json]

A folder stands for all descriptions in it. The claims and the truth stand in oracles/any_arm.py.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from bench.measure import map_on_all_cores
from bench.tables import format_table
from oracles.any_arm import DISTANCES_NAMED, ArmOutcome, ToolMove, examine_arm, list_arms

MOVES = 30  # of each distance
PARTS = (50.0, 90.0, 99.0, 99.5, 100.0)  # % of all moves
FARTHEST = 3e-3  # m past its rest, in any move
# Claims about all moves: text of a violation, its test, and the largest share of violations.
CLAIMS: tuple[tuple[str, Callable[[ToolMove], bool], float], ...] = (
    ("did not arrive", lambda move: bool(move.words), 0.01),
    ("past their rest by more than 1 mm and 0.5 %", lambda move: move.has_overshot, 0.005),
    ("past their rest by more than 3 mm", lambda move: move.past > FARTHEST, 0.0),
    ("off a line by more than 1 mm and 1 %", lambda move: move.is_off_line, 0.01),
    ("faster than a limit", lambda move: move.peak_speed > 1.0, 0.0),
    ("accelerated beyond a limit", lambda move: move.peak_acceleration > 1.0, 0.0),
    ("torques beyond a limit", lambda move: move.peak_torque > 1.0, 0.0),
)


def main() -> None:
    """Print a row per arm, what all moves did, what failed; exit code 1 if a claim is broken."""
    parser = argparse.ArgumentParser(
        prog="bench.physics.any_arm", description=__doc__.splitlines()[0]
    )
    parser.add_argument("robots", nargs="*", help="names, parts of them, files, or folders")
    parser.add_argument("--moves", type=int, default=MOVES, help="of each distance")
    parser.add_argument("--out", type=Path, default=Path("out/any_arm.json"))
    arguments = parser.parse_args()
    outcomes = examine_all(choose_robots(arguments.robots), arguments.moves)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps([asdict(outcome) for outcome in outcomes], indent=1))
    print(write_report(outcomes))
    print(list_failures(outcomes))
    print(f"\nall moves are in {arguments.out}")
    moves = [move for outcome in outcomes for move in outcome.moves]
    sys.exit(any(sum(map(fails, moves)) > share * len(moves) for _, fails, share in CLAIMS))


def choose_robots(robots: Sequence[str]) -> dict[str, Path | str]:
    """Return the arms that are named, all without names."""
    shipped_arms = list_arms()
    if not robots:
        return shipped_arms
    chosen_robots: dict[str, Path | str] = {}
    for path in robots:
        if Path(path).is_dir():
            chosen_robots |= {file.stem: file for file in sorted(Path(path).glob("*.urdf"))}
        elif Path(path).is_file():
            chosen_robots[Path(path).stem] = Path(path)
        else:
            chosen_robots |= {name: robot for name, robot in shipped_arms.items() if path in name}
    return chosen_robots


def examine_all(robots: dict[str, Path | str], moves: int) -> list[ArmOutcome]:
    """Return the outcome of every arm."""
    return map_on_all_cores(
        "arms", _examine_arm, [(name, robots[name], moves) for name in sorted(robots)]
    )


def _examine_arm(which: tuple[str, Path | str, int]) -> ArmOutcome:
    return examine_arm(*which)


def run_bench(quick: bool) -> list[ArmOutcome]:
    """Examine all arms that are there."""
    return examine_all(list_arms(), 5 if quick else MOVES)


def write_report(outcomes: list[ArmOutcome]) -> str:
    """Return a row per arm, and parts of all moves, as Markdown."""
    moves = [move for outcome in outcomes for move in outcome.moves]
    if not moves:
        return "no arm moved"
    heads = ("arm", "joints", *DISTANCES_NAMED, "median, s", "worst, s", "past, mm", "off line, mm",
             "speed", "acceleration", "torque")  # fmt: skip
    straight = [move for move in moves if move.is_straight]
    rows: list[tuple[str, list[float]]] = [
        ("past its rest, mm", [1e3 * max(0.0, move.past) for move in moves]),
        ("past its rest, %",
         [1e2 * max(0.0, move.past) / max(move.length, 1e-9) for move in moves]),
        (f"off the line, mm ({len(straight)} straight)", [1e3 * move.aside for move in straight]),
        ("speed / limit", [move.peak_speed for move in moves]),
        ("acceleration / limit", [move.peak_acceleration for move in moves]),
        ("torque / limit", [move.peak_torque for move in moves]),
        *((f"seconds, {key}", [m.seconds for m in moves if m.distance == key])
          for key in DISTANCES_NAMED),
    ]  # fmt: skip
    parts = (
        (words, *(f"{part:.3g}" for part in np.percentile(values or [np.nan], PARTS)))
        for words, values in rows
    )
    return "\n\n".join([
        format_table(heads, (_list_cells(o) for o in outcomes if o.moves), numbers=True),
        f"All {len(moves)} moves of {sum(bool(o.moves) for o in outcomes)} arms:",
        format_table(("at most in", *(f"{part:g} %" for part in PARTS)), parts, numbers=True),
    ])  # fmt: skip


def list_failures(outcomes: list[ArmOutcome]) -> str:
    """Return how often each claim was broken, by which arms, and what was refused."""
    moves = [move for outcome in outcomes for move in outcome.moves]
    lines = [""]
    for words, fails, share in CLAIMS:
        by = {outcome.name: sum(map(fails, outcome.moves)) for outcome in outcomes}
        named = ", ".join(f"{name} {count}" for name, count in by.items() if count)
        lines.append(f"{sum(by.values())} of {len(moves)} {words} ({share:.1%} allowed): {named}")
    for result in outcomes:
        reasons = {move.words for move in result.moves if move.words}
        lines += [
            f"{result.name}: {words}" for words in ({result.refused} if result.refused else reasons)
        ]
    return "\n".join(lines)


def _list_cells(outcome: ArmOutcome) -> list[str]:
    times = [m.seconds for m in outcome.arrived] or [float("nan")]
    return [
        outcome.name.removeprefix("own: "),
        str(outcome.joints),
        *(
            f"{sum(not m.words for m in outcome.select_moves(key))}"
            f"/{len(outcome.select_moves(key))}"
            for key in DISTANCES_NAMED
        ),
        f"{np.median(times):.2f}",
        f"{max(times):.2f}",
        f"{1e3 * max(m.past for m in outcome.moves):.2f}",
        f"{1e3 * max((m.aside for m in outcome.moves if m.is_straight), default=np.nan):.2f}",
        f"{max(m.peak_speed for m in outcome.moves):.2f}",
        f"{max(m.peak_acceleration for m in outcome.moves):.2f}",
        f"{max(m.peak_torque for m in outcome.moves):.2f}",
    ]


if __name__ == "__main__":
    main()
