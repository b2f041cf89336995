"""A scenario: duration, start and targets of a run."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from arm_emulator.extension.base import POSITION, TOOL_POSITION, Array, Number, Section
from arm_emulator.extension.machine import Scene
from arm_emulator.extension.runs import TargetTable, check_targets, load_target_table

SECONDS = Number("seconds", "s", above=0.0, at_most=1e6, text="how long a run lasts")
AT = Number("at", "s", at_least=0.0, at_most=1e6, text="when it holds from")
WAYS = ("by", "to", "along")
MOST_POINTS = 1000


@dataclass(frozen=True)
class Move:
    """A target of the tool.

    Attributes:
        at: time [s].
        way: "by" a displacement from where the tool started, "to" a point of the world, or
            "along" displacements, one after the other.
        points: (K, 3) [m].
    """

    at: float
    way: str
    points: Array


@dataclass(frozen=True)
class Scenario:
    """Events of a run, except faults.

    Attributes:
        seconds: duration [s].
        start: joint positions at its start (N,) [rad or m].
        targets: joint targets, which go to the servo as they are; None: the motion controller
            leads the arm.
        moves: of the tool, by the motion controller.
    """

    seconds: float
    start: Array
    targets: TargetTable | None
    moves: tuple[Move, ...]

    @property
    def table(self) -> TargetTable:
        """The targets from time 0 on; the start until the first one."""
        held, table = TargetTable(np.zeros(1), self.start[None]), self.targets
        if table is None:
            return held
        if table.t[0] <= 0.0:
            return table
        return TargetTable(np.append(held.t, table.t), np.vstack([held.q, table.q]))


def read_scenario(section: Section, scene: Scene, folder: Path) -> Scenario:
    """Return the scenario of a section.

    Args:
        section: of the campaign's file.
        scene: the machine.
        folder: where files are that it names.

    Raises:
        Refusal: an invalid key or value.
    """
    names = scene.joint_names
    seconds = section.number(SECONDS)
    start = scene.start
    if (given := section.section("start")) is not None:
        start = _read_joints(given, names, start)
    targets, moves = section.entries("targets"), section.entries("moves")
    table = section.text("table") if section.has("table") else ""
    if (len(targets) > 0) + bool(table) + (len(moves) > 0) > 1:
        rule = "have one of targets, table and moves"
        raise section.refusal("moves" if moves else "table", rule, "several")
    found = None
    if table:
        found = load_target_table(folder / table, names, partial(check_targets, scene))
    elif targets:
        found = _read_targets(section, targets, names, start)
        where = f"{section.where}: scenario"
        check_targets(scene, where, [f"targets.{k}" for k in range(len(targets))], found.t, found.q)
    return Scenario(seconds, start, found, _read_moves(section, moves))


def _read_joints(section: Section, names: Sequence[str], q: Array) -> Array:
    """Return joint positions, some of which a section gives."""
    q = q.copy()
    for place, name in enumerate(names):
        if section.has(name):
            q[place] = section.number(POSITION.named(name))
    return q


def _read_entry(section: Section, key: str, place: int, entry: object) -> Section:
    """Return an entry of a list as a section, named after its place."""
    name = f"{key}.{place}"
    section.put(name, entry)
    return section.required_section(name)


def _read_targets(
    section: Section, entries: list[object], names: Sequence[str], start: Array
) -> TargetTable:
    t: list[float] = []
    rows: list[Array] = []
    for place, entry in enumerate(entries):
        one = _read_entry(section, "targets", place, entry)
        t.append(one.number(AT))
        if place and not t[-1] > t[-2]:
            raise one.refusal("at", f"be later than that before, {t[-2]:g} s", t[-1])
        rows.append(_read_joints(one, names, rows[-1] if rows else start))
    return TargetTable(np.array(t), np.array(rows))


def _read_moves(section: Section, entries: list[object]) -> tuple[Move, ...]:
    moves: list[Move] = []
    for place, entry in enumerate(entries):
        one = _read_entry(section, "moves", place, entry)
        at = one.number(AT)
        ways = [way for way in WAYS if one.has(way)]
        if len(ways) != 1:
            raise one.refusal("by", f"be one of {', '.join(WAYS)}", ", ".join(ways) or "none")
        moves.append(Move(at, ways[0], _read_points(one, ways[0])))
    if any(later.at <= one.at for one, later in itertools.pairwise(moves)):
        got = ", ".join(f"{one.at:g}" for one in moves)
        raise section.refusal("moves", "have ascending times", got)
    return tuple(moves)


def _read_points(section: Section, way: str) -> Array:
    bound = TOOL_POSITION.named(way)
    if way != "along":
        return np.array([section.vector(bound)])
    points = section.entries(way)
    fits = 1 <= len(points) <= MOST_POINTS and all(
        isinstance(point, list) and len(point) == 3 and all(map(bound.holds, point))
        for point in points
    )
    if not fits:
        rule = f"be 1 to {MOST_POINTS} points of 3 {bound.range}"
        raise section.refusal(way, rule, repr(points))
    return np.array(points, np.float64)


def count_ticks(seconds: float, period: float) -> int:
    """Return the first tick that is not before a time; those of the end of a run at least 1."""
    return math.ceil(seconds / period - 1e-6) if math.isfinite(seconds) else 2**62
