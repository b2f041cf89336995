"""Arms that move, settle and rest under our servo: in a fleet, and one in its loop in C."""

from __future__ import annotations

import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator import Scene, load_gains, load_scene
from arm_emulator.runs.table_run import TableRun, load_table_run
from arm_emulator_fleet import Fleet, ServoFleet
from bench.measure import Task, show_progress, time_interleaved
from bench.tables import format_table

TITLE = "Arms at rest"

SCENES = ("ur5", "panda")
ARMS = 64
MOVE, SETTLED = 0.5, 6.0  # s: of a motion, and when arms rest after it
SIZE = 0.15  # rad, of an arm's motion at most
# The phases of a fleet: from when on they are timed [s], and for how long.
PHASES = {"moving": (0.1, 0.4), "settling": (0.5, 1.0), "at rest": (SETTLED, 0.5)}
LOOP = 60.0  # s, of one arm in its loop
EVERY = {"one move": LOOP, "a move every 3 s": 3.0}  # s


def run(quick: bool) -> dict[str, Any]:
    """Measure the phases of a fleet on one core, and runs of one arm from their start."""
    repetitions = 3 if quick else 9
    figures = {}
    with show_progress(
        "arms at rest", repetitions * len(SCENES) * (len(PHASES) + len(EVERY))
    ) as done:
        for name in SCENES:
            scene = load_scene(name)
            fleet = Fleet(scene, ARMS, workers=1)
            per_second = ARMS * scene.steps_per_period / scene.servo_period
            with tempfile.TemporaryDirectory() as folder:
                tasks = {phase: _make_phase_task(fleet, phase) for phase in PHASES}
                tasks |= {motion: _make_loop_task(scene, Path(folder), motion) for motion in EVERY}
                timings = time_interleaved(tasks, repetitions, done)
            figures[name] = {
                "phases": {
                    phase: asdict(timings[phase].per(PHASES[phase][1] * per_second))
                    for phase in PHASES
                },
                "loops": {motion: asdict(timings[motion].per(LOOP)) for motion in EVERY},
            }
    return figures


def _make_phase_task(fleet: Fleet, phase: str) -> Task:
    """Return the task of following all arms through a phase, each on a motion of its own."""
    scene, gains = fleet.scene, load_gains(fleet.scene.name).servo
    begin, length = (round(t / scene.servo_period) for t in PHASES[phase])
    away = np.random.default_rng(1).uniform(-SIZE, SIZE, (ARMS, len(scene.joints)))
    rise = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, round(MOVE / scene.servo_period)))
    frame = fleet.frame()
    servos = ServoFleet(fleet, gains)

    def prepare(_: int) -> None:
        fleet.reset()
        servos.reset()
        servos.aim(scene.start + rise[:, np.newaxis, np.newaxis] * away)
        fleet.follow(servos, begin, out=frame)

    return Task(lambda _: fleet.follow(servos, length, out=frame), prepare)


def _make_loop_task(scene: Scene, folder: Path, motion: str) -> Task:
    """Return the task of a run from tick 0 with our servo in C, and with a motion now and then."""
    t = np.arange(0.0, LOOP, 0.01)
    repeats, since = np.divmod(t, EVERY[motion])
    rise = 0.5 - 0.5 * np.cos(np.pi * np.minimum(since / MOVE, 1.0))
    share = np.where(repeats % 2 == 0, rise, 1.0 - rise)
    signs = (-1.0) ** np.arange(len(scene.joints))
    rows = np.column_stack([t, scene.start + SIZE * share[:, np.newaxis] * signs])
    file = folder / f"{scene.name}_{len(motion)}.csv"
    header = ",".join(("t", *scene.joint_names))
    np.savetxt(file, rows, delimiter=",", header=header, comments="")
    ready: list[TableRun] = []

    def prepare(_: int) -> None:
        ready[:] = [load_table_run(scene.name, file, None)[0]]

    periods = round(LOOP / scene.servo_period)
    return Task(lambda _: ready[0].advance(periods), prepare)


def report(figures: dict[str, Any]) -> str:
    """Return the table of the page on fleets."""
    rows = []
    for name, of in figures.items():
        times = (f"{1e9 * of['phases'][phase]['median']:.0f} ns" for phase in PHASES)
        rates = (f"{1.0 / of['loops'][motion]['median']:.0f}" for motion in EVERY)
        rows.append((f"`{name}`", *times, *rates))
    heads = [f"{phase}: an arm and step" for phase in PHASES]
    heads += [f"one arm, {motion} in {LOOP:g} s" for motion in EVERY]
    return format_table(("under our servo, one core", *heads), rows)
