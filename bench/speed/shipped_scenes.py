"""Time of an integration step of each shipped scene: as its file has it, and stripped."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from arm_emulator import Plant, Pose, Scene, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.demo.demo_plan import DemoPlan
from arm_emulator.runs.offline import load_offline_run
from bench.measure import Task, compile_all, measure_interleaved, show_progress
from bench.speed.bare import BARE
from bench.tables import format_table

TITLE = "A step of each scene as shipped"

SCENES = ("three_axis", "ur5", "panda")
REST = 0.2  # s of rest at the end of the motion, before it is timed and while it is timed
MOVING, RESTING, STRIPPED = "in the demo's motion", "at rest under the servo", "stripped, moving"


def run_bench(quick: bool) -> dict[str, Any]:
    """Measure every scene under the commands of the demo's motion, recorded in closed loop."""
    repetitions = 5 if quick else 15
    shipped = {name: load_scene(name) for name in SCENES}
    stripped = {name: load_scene(name, BARE) for name in SCENES}
    compile_all([*shipped.values(), *stripped.values()])
    figures = {}
    with show_progress("a step as shipped", 3 * repetitions * len(SCENES)) as done:
        for name, scene in shipped.items():
            tasks, steps = _make_tasks(scene, stripped[name])
            timings = measure_interleaved(tasks, repetitions, done)
            figures[name] = {
                "joints": len(scene.joints),
                "dt": scene.integrator.dt,
                "scheme": scene.integrator.scheme,
                "events": scene.integrator.events,
                "times": {task: asdict(timings[task].divide_by(steps[task])) for task in tasks},
            }
    return figures


def _make_tasks(scene: Scene, stripped: Scene) -> tuple[dict[str, Task], dict[str, int]]:
    """Return what is timed of a scene, and how many steps each task takes."""
    rows, settle = _record_demo_commands(scene)
    moving = rows[settle:]
    rest = np.repeat(rows[-1:], round(REST / scene.servo_period), axis=0)
    tasks = {
        MOVING: _make_timed_task(Plant(scene), rows[:settle], moving),
        RESTING: _make_timed_task(Plant(scene), np.concatenate((rows, rest)), rest),
        STRIPPED: _make_timed_task(
            Plant(stripped), moving[:0], _make_voltages(stripped, len(moving))
        ),
    }
    lengths = {MOVING: len(moving), RESTING: len(rest), STRIPPED: len(moving)}
    return tasks, {task: lengths[task] * _count_steps(scene) for task in tasks}


def _record_demo_commands(scene: Scene) -> tuple[Array, int]:
    """Return the commands of settling and of the demo's first second (K, N), and the first's K."""
    offline_run = load_offline_run(scene.name)
    plan = DemoPlan.load_plan(
        find_scene(scene.name), offline_run.motion_ticks * offline_run.session.period_ns
    )
    R_WT, p_WT = offline_run.controller.kinematics.forward(scene.start)
    offline_run.instructor.add(plan.settle_ns, Pose(p_WT + plan.displacement, R_WT))
    settle, rows = plan.settle_ns // offline_run.session.period_ns, []
    for _ in range(settle + round(1.0 / scene.servo_period)):
        offline_run.advance(1)
        rows.append(offline_run.session.measured.applied)
    return np.array(rows), settle


def _make_timed_task(plant: Plant, before: Array, rows: Array) -> Task:
    """Return the task of running under `rows`, once the machine has run under `before`."""
    steps = _count_steps(plant.scene)

    def prepare_machine(_: int) -> None:
        plant.reset()
        plant.run(before, steps)

    return Task(lambda _: plant.run(rows, steps), prepare_machine)


def _count_steps(scene: Scene) -> int:
    return scene.steps_per_period


def _make_voltages(scene: Scene, periods: int) -> Array:
    """Return 3 V of changing sign from joint to joint: a stripped motor takes voltages."""
    return np.tile(3.0 * (-1.0) ** np.arange(len(scene.joints)), (periods, 1))


def write_report(figures: dict[str, Any]) -> str:
    """Return the table of README.md."""
    rows = []
    for name, scene in figures.items():
        times = (f"{1e9 * scene['times'][task]['median']:.0f} ns" for task in scene["times"])
        about = f"{scene['joints']} joints, {1e6 * scene['dt']:g} µs, events `{scene['events']}`"
        rows.append((f"`{name}` ({about})", *times))
    return format_table(("one step on one core", MOVING, RESTING, STRIPPED), rows)
