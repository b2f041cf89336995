"""A scenario: duration, start and targets of a run."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_emulator.extension.base import POSITION, TOOL_POSITION, Array, Number, Section
from arm_emulator.extension.machine import Scene
from arm_emulator.extension.runs import TargetTable, check_targets, load_target_table

SECONDS = Number("seconds", "s", above=0.0, at_most=1e6, text="how long a run lasts")
AT = Number("at", "s", at_least=0.0, at_most=1e6, text="when it holds from")
TARGET_KEYS = ("by", "to", "along")
MAX_POINTS = 1000


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
        initial, table = TargetTable(np.zeros(1), self.start[None]), self.targets
        if table is None:
            return initial
        if table.t[0] <= 0.0:
            return table
        return TargetTable(np.append(initial.t, table.t), np.vstack([initial.q, table.q]))


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
    seconds = section.read_number(SECONDS)
    start = scene.start
    if (start_section := section.get_section("start")) is not None:
        start = _read_joints(start_section, names, start)
    targets, moves = section.read_entries("targets"), section.read_entries("moves")
    table = section.read_text("table") if section.has_key("table") else ""
    if (len(targets) > 0) + bool(table) + (len(moves) > 0) > 1:
        rule = "have one of targets, table and moves"
        raise section.make_refusal("moves" if moves else "table", rule, "several")
    target_table = None
    if table:
        target_table = load_target_table(folder / table, names, partial(check_targets, scene))
    elif targets:
        target_table = _read_targets(section, targets, names, start)
        where = f"{section.where}: scenario"
        check_targets(
            scene,
            where,
            [f"targets.{k}" for k in range(len(targets))],
            target_table.t,
            target_table.q,
        )
    return Scenario(seconds, start, target_table, _read_moves(section, moves))


def _read_joints(section: Section, names: Sequence[str], q: Array) -> Array:
    """Return joint positions, some of which a section gives."""
    q = q.copy()
    for place, name in enumerate(names):
        if section.has_key(name):
            q[place] = section.read_number(POSITION.rename(name))
    return q


def _read_entry(section: Section, key: str, place: int, entry: object) -> Section:
    """Return an entry of a list as a section, named after its place."""
    name = f"{key}.{place}"
    section.set_value(name, entry)
    return section.require_section(name)


def _read_targets(
    section: Section, entries: list[object], names: Sequence[str], start: Array
) -> TargetTable:
    t: list[float] = []
    rows: list[Array] = []
    for place, entry in enumerate(entries):
        entry_section = _read_entry(section, "targets", place, entry)
        t.append(entry_section.read_number(AT))
        if place and not t[-1] > t[-2]:
            raise entry_section.make_refusal("at", f"be later than that before, {t[-2]:g} s", t[-1])
        rows.append(_read_joints(entry_section, names, rows[-1] if rows else start))
    return TargetTable(np.array(t), np.array(rows))


def _read_moves(section: Section, entries: list[object]) -> tuple[Move, ...]:
    moves: list[Move] = []
    for place, entry in enumerate(entries):
        entry_section = _read_entry(section, "moves", place, entry)
        at = entry_section.read_number(AT)
        chosen = [key for key in TARGET_KEYS if entry_section.has_key(key)]
        if len(chosen) != 1:
            raise entry_section.make_refusal(
                "by", f"be one of {', '.join(TARGET_KEYS)}", ", ".join(chosen) or "none"
            )
        moves.append(Move(at, chosen[0], _read_points(entry_section, chosen[0])))
    if any(later.at <= move.at for move, later in itertools.pairwise(moves)):
        times = ", ".join(f"{move.at:g}" for move in moves)
        raise section.make_refusal("moves", "have ascending times", times)
    return tuple(moves)


def _read_points(section: Section, key: str) -> Array:
    bound = TOOL_POSITION.rename(key)
    if key != "along":
        return np.array([section.read_vector(bound)])
    points = section.read_entries(key)
    fits = 1 <= len(points) <= MAX_POINTS and all(
        isinstance(point, list) and len(point) == 3 and all(map(bound.is_in_range, point))
        for point in points
    )
    if not fits:
        rule = f"be 1 to {MAX_POINTS} points of 3 {bound.range}"
        raise section.make_refusal(key, rule, repr(points))
    return np.array(points, np.float64)


def count_ticks(seconds: float, period: float) -> int:
    """Return the first tick that is not before a time; those of the end of a run at least 1."""
    return int(count_all_ticks(seconds, period))


def count_all_ticks(seconds: ArrayLike, period: float) -> NDArray[np.int64]:
    """Return the same of several times; at most 2**61, which never comes."""
    ticks = np.ceil(np.asarray(seconds, np.float64) / period - 1e-6)
    return np.minimum(ticks, 2.0**61).astype(np.int64)
