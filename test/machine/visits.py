"""Visits to the past of a table run, and forks, against runs that went straight on."""

from collections.abc import Callable

import numpy as np

from arm_emulator.runs.table_run import TableRun
from arm_emulator.runs.target_table import TargetTable
from arm_emulator.runs.timeline import Timeline


def random_visits(fresh: Callable[[], TableRun], rng: np.random.Generator, last: int = 300) -> None:
    """Go on, fork, and come back to any tick: the machine is as in runs that went straight on."""
    visited, straight, forked = fresh(), fresh(), fresh()
    start = visited.session.scene.start
    table = TargetTable(np.array([0.0, 0.15]), start + rng.uniform(-0.1, 0.1, (2, len(start))))
    expected = [straight.session.plant.save(), *states(straight, last)]
    line = Timeline(visited, every=64)
    line.advance(last)
    for tick in [*rng.choice(last, 8), last]:
        line.go_to(int(tick))
        assert visited.session.plant.save() == expected[tick], f"at tick {tick} of {last}"
    line.go_to(100)
    fork = line.fork()
    fork.change("another table", lambda run: run.set_table(table))
    fork.advance(100)
    line.go_to(last)
    fork.go_to(170)
    forked.advance(100)
    forked.set_table(table)
    forked.advance(70)
    assert visited.session.plant.save() == forked.session.plant.save() != expected[170], "the fork"


def states(table_run: TableRun, ticks: int) -> list[bytes]:
    """Go on tick by tick; return the machine's whole state at each."""
    saved = []
    for _ in range(ticks):
        table_run.advance(1)
        saved.append(table_run.session.plant.save())
    return saved
