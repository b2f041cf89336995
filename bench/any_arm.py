"""Any serial arm, from its robot description alone: does it go where it is sent, and how?

    python -m bench.any_arm [ROBOT ...] [--moves 30] [--out out/any_arm]

A folder stands for all descriptions in it. The claims and the truth stand in oracles/any_arm.py.
Each arm's outcome is a file in `--out`; a run that was broken off goes on behind the last one.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path

import numpy as np

from bench.measure import progress
from oracles.any_arm import DISTANCES_NAMED, Move, Outcome, arms, examine
from oracles.own_robots import OWN

OUT = Path("out/any_arm")
MOVES = 30  # of each distance
PARTS = (50.0, 90.0, 99.0, 99.5, 100.0)  # % of all moves
FARTHEST = 3e-3  # m past its rest, in any move
# Claims about all moves: text of a violation, its test, and the largest share of violations.
CLAIMS: tuple[tuple[str, Callable[[Move], bool], float], ...] = (
    ("did not arrive", lambda one: bool(one.words), 0.01),
    ("past their rest by more than 1 mm and 0.5 %", lambda one: one.overshot, 0.005),
    ("past their rest by more than 3 mm", lambda one: one.past > FARTHEST, 0.0),
    ("off a line by more than 1 mm and 1 %", lambda one: one.off_line, 0.01),
    ("faster than a limit", lambda one: one.peak_speed > 1.0, 0.0),
    ("accelerated beyond a limit", lambda one: one.peak_acceleration > 1.0, 0.0),
    ("torques beyond a limit", lambda one: one.peak_torque > 1.0, 0.0),
)


def main() -> None:
    """Print a row per arm, what all moves did, what failed; exit code 1 if a claim is broken."""
    parser = argparse.ArgumentParser(prog="bench.any_arm", description=__doc__.splitlines()[0])
    parser.add_argument("robots", nargs="*", help="names, parts of them, files, or folders")
    parser.add_argument("--moves", type=int, default=MOVES, help="of each distance")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args()
    began = time.monotonic()
    outcomes = examined(chosen(arguments.robots), arguments.moves, arguments.jobs, arguments.out)
    print(report(outcomes))
    print(failures(outcomes))
    print(f"\n{time.monotonic() - began:.0f} s; all moves are in {arguments.out}")
    moves = [one for outcome in outcomes for one in outcome.moves]
    sys.exit(any(sum(map(fails, moves)) > share * len(moves) for _, fails, share in CLAIMS))


def chosen(robots: Sequence[str]) -> dict[str, Path | str]:
    """Return the arms that are named, all without names."""
    known = arms()
    if not robots:
        return known
    found: dict[str, Path | str] = {}
    for one in robots:
        if Path(one).is_dir():
            found |= {file.stem: file for file in sorted(Path(one).glob("*.urdf"))}
        elif Path(one).is_file():
            found[Path(one).stem] = Path(one)
        else:
            found |= {name: robot for name, robot in known.items() if one in name}
    return found


def examined(robots: dict[str, Path | str], moves: int, jobs: int, out: Path) -> list[Outcome]:
    """Return the outcome of every arm, of those that are not there yet by new runs."""
    out.mkdir(parents=True, exist_ok=True)
    places = {name: out / f"{_digest(name, robot, moves)}.json" for name, robot in robots.items()}
    missing = {name: robots[name] for name, place in places.items() if not place.exists()}
    with ProcessPoolExecutor(jobs) as pool, progress("arms", len(missing)) as tick:
        runs = {pool.submit(examine, n, r, moves): n for n, r in missing.items()}
        for run in as_completed(runs):
            name = runs[run]
            text = json.dumps(asdict(run.result()), indent=1)
            places[name].with_suffix(".part").write_text(text, encoding="utf-8")
            places[name].with_suffix(".part").rename(places[name])
            tick(name)
    return [_outcome(places[name]) for name in sorted(places)]


def _digest(name: str, robot: Path | str, moves: int) -> str:
    text = OWN[robot]() if isinstance(robot, str) else robot.read_text(errors="surrogateescape")
    content = f"{name} {moves} {text}".encode(errors="surrogateescape")
    return f"{name.replace('/', '_').replace(': ', '_')}_{hashlib.sha256(content).hexdigest()[:8]}"


def _outcome(place: Path) -> Outcome:
    values = json.loads(place.read_text(encoding="utf-8"))
    return Outcome(**values | {"moves": [Move(**one) for one in values["moves"]]})


def run(quick: bool) -> list[Outcome]:
    """Examine all arms that are there."""
    return examined(arms(), 5 if quick else MOVES, 1, OUT)


def report(outcomes: list[Outcome]) -> str:
    """Return a row per arm, and parts of all moves, as Markdown."""
    heads = ("arm", "joints", *DISTANCES_NAMED, "median, s", "worst, s", "past, mm", "off line, mm")
    lines = _table((*heads, "speed", "acceleration", "torque"))
    for one in outcomes:
        if one.moves:
            lines.append(_row(one))
    moves = [one for outcome in outcomes for one in outcome.moves]
    if not moves:
        return "no arm moved"
    lines += ["", f"All {len(moves)} moves of {sum(bool(o.moves) for o in outcomes)} arms:", ""]
    lines += _table(("at most in", *(f"{part:g} %" for part in PARTS)))
    straight = [one for one in moves if one.straight]
    rows: list[tuple[str, list[float]]] = [
        ("past its rest, mm", [1e3 * max(0.0, one.past) for one in moves]),
        ("past its rest, %", [1e2 * max(0.0, one.past) / max(one.length, 1e-9) for one in moves]),
        (f"off the line, mm ({len(straight)} straight)", [1e3 * one.aside for one in straight]),
        ("speed / limit", [one.peak_speed for one in moves]),
        ("acceleration / limit", [one.peak_acceleration for one in moves]),
        ("torque / limit", [one.peak_torque for one in moves]),
        *((f"seconds, {key}", [m.seconds for m in moves if m.distance == key])
          for key in DISTANCES_NAMED),
    ]  # fmt: skip
    for words, values in rows:
        shown = (f"{value:.3g}" for value in np.percentile(values or [np.nan], PARTS))
        lines.append(f"| {words} | {' | '.join(shown)} |")
    return "\n".join(lines)


def failures(outcomes: list[Outcome]) -> str:
    """Return how often each claim was broken, by which arms, and what was refused."""
    moves = [one for outcome in outcomes for one in outcome.moves]
    lines = [""]
    for words, fails, share in CLAIMS:
        by = {one.name: sum(map(fails, one.moves)) for one in outcomes}
        named = ", ".join(f"{name} {count}" for name, count in by.items() if count)
        lines.append(f"{sum(by.values())} of {len(moves)} {words} ({share:.1%} allowed): {named}")
    for one in outcomes:
        reasons = {move.words for move in one.moves if move.words}
        lines += [f"{one.name}: {words}" for words in ({one.refused} if one.refused else reasons)]
    return "\n".join(lines)


def _table(heads: Sequence[str]) -> list[str]:
    return [f"| {' | '.join(heads)} |", f"|---{'|---:' * (len(heads) - 1)}|"]


def _row(one: Outcome) -> str:
    times = [m.seconds for m in one.arrived] or [float("nan")]
    cells = [
        one.name.removeprefix("own: "),
        str(one.joints),
        *(f"{sum(not m.words for m in one.of(key))}/{len(one.of(key))}" for key in DISTANCES_NAMED),
        f"{np.median(times):.2f}",
        f"{max(times):.2f}",
        f"{1e3 * max(m.past for m in one.moves):.2f}",
        f"{1e3 * max((m.aside for m in one.moves if m.straight), default=np.nan):.2f}",
        f"{max(m.peak_speed for m in one.moves):.2f}",
        f"{max(m.peak_acceleration for m in one.moves):.2f}",
        f"{max(m.peak_torque for m in one.moves):.2f}",
    ]
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
