"""Visits to the past of a table run, and forks, against runs that went straight on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from arm_emulator.runs.table_run import TableRun
from arm_emulator.runs.target_table import TargetTable
from arm_emulator.runs.timeline import Timeline


def random_visits(fresh: Callable[[], TableRun], rng: np.random.Generator, last: int = 300) -> None:
    """Go on, fork, and come back to any tick: the machine is as in runs that went straight on."""
    one, straight, other = fresh(), fresh(), fresh()
    start = one.session.scene.start
    table = TargetTable(np.array([0.0, 0.15]), start + rng.uniform(-0.1, 0.1, (2, len(start))))
    wanted = [straight.session.plant.save(), *states(straight, last)]
    line = Timeline(one, every=64)
    line.advance(last)
    for tick in [*rng.choice(last, 8), last]:
        line.go_to(int(tick))
        assert one.session.plant.save() == wanted[tick], f"at tick {tick} of {last}"
    line.go_to(100)
    fork = line.fork()
    fork.change("another table", lambda run: run.aim(table))
    fork.advance(100)
    line.go_to(last)
    fork.go_to(170)
    other.advance(100)
    other.aim(table)
    other.advance(70)
    assert one.session.plant.save() == other.session.plant.save() != wanted[170], "the fork"


def states(one: TableRun, ticks: int) -> list[bytes]:
    """Go on tick by tick; return the machine's whole state at each."""
    saved = []
    for _ in range(ticks):
        one.advance(1)
        saved.append(one.session.plant.save())
    return saved
