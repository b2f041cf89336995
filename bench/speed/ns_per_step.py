"""Time of one integration step, for arms of 3 to 24 joints, beside MuJoCo."""

from __future__ import annotations

import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator import Plant, Scene, load_scene
from arm_emulator.machine.schemes.known import SCHEMES
from bench.measure import (
    Task,
    WallTime,
    compile_all,
    make_stepping_task,
    measure_interleaved,
    show_progress,
)
from bench.pictures import COLOURS, PEERS, make_figure, save_picture
from bench.speed.bare import BARE
from bench.speed.chains import write_chain
from bench.speed.mujoco_peer import INTEGRATORS, MujocoArm
from bench.tables import format_table

TITLE = "Time per step"

ROBOTS = {"three_axis": 3, "ur5": 6, "panda": 7}
CHAINS = (12, 24)
STEPS = dict.fromkeys(SCHEMES, 20_000)  # in one measurement
MUJOCO_STEPS = 2_000
CASES_PER_MACHINE = len(SCHEMES) + len(INTEGRATORS)
DT = 1e-5  # s; what a step costs does not depend on it
VOLTAGE = 3.0  # V, of changing sign from joint to joint: everything moves
CALLS = 1_000  # servo periods, for the cost of a call from Python


def run_bench(quick: bool) -> dict[str, Any]:
    """Measure every arm."""
    repetitions = 5 if quick else 15
    with tempfile.TemporaryDirectory() as folder:
        arms = {name: _load_schemes(name) for name in ROBOTS}
        for joints in () if quick else CHAINS:
            arms[f"chain_{joints}"] = {
                scheme: write_chain(Path(folder), joints, **{"integrator.scheme": scheme})
                for scheme in SCHEMES
            }
        compile_all(scene for schemes in arms.values() for scene in schemes.values())
        figures: dict[str, Any] = {"arms": {}}
        with show_progress("time per step", repetitions * len(arms) * CASES_PER_MACHINE) as done:
            for name, schemes in arms.items():
                tasks = _make_tasks(schemes)
                timings = measure_interleaved(tasks, repetitions, done)
                per_step = {task: asdict(_get_per_step(task, t)) for task, t in timings.items()}
                figures["arms"][name] = {"joints": len(schemes["paper"].joints), "times": per_step}
        figures["python_call"] = _measure_calls(arms["three_axis"]["rosenbrock"], repetitions)
    return figures


def _load_schemes(name: str) -> dict[str, Scene]:
    return {
        scheme: load_scene(name, {**BARE, "integrator.scheme": scheme, "integrator.dt": DT})
        for scheme in SCHEMES
    }


def _make_tasks(schemes: dict[str, Scene]) -> dict[str, Task]:
    N = len(schemes["paper"].joints)
    voltage = VOLTAGE * (-1.0) ** np.arange(N)[None, :]
    tasks: dict[str, Task] = {}
    for scheme, steps in STEPS.items():
        tasks[scheme] = make_stepping_task(
            Plant(schemes[scheme]), voltage, steps, about=20e-9 * N * steps
        )
    for integrator in INTEGRATORS:
        arm = MujocoArm(schemes["paper"], integrator, DT)
        tasks[f"MuJoCo {integrator}"] = make_stepping_task(
            arm, voltage, MUJOCO_STEPS, about=0.7e-6 * N * MUJOCO_STEPS
        )
    return tasks


def _get_per_step(task: str, measured: WallTime) -> WallTime:
    if task in STEPS:
        return measured.divide_by(STEPS[task])
    return measured.divide_by(MUJOCO_STEPS)


def _measure_calls(scene: Scene, repetitions: int) -> dict[str, Any]:
    """Measure what a call from Python costs, with the voltages handed over and no step taken."""
    plant = Plant(scene)
    arm = MujocoArm(scene, "implicitfast", DT)
    row = np.full(len(scene.joints), VOLTAGE)
    rows = np.tile(row, (CALLS, 1))

    def call_plant(_: int) -> None:
        for _ in range(CALLS):
            plant.advance(row, 0)

    timings = measure_interleaved(
        {"Plant.advance": Task(call_plant), "MuJoCo mj_step": make_stepping_task(arm, rows, 0)},
        repetitions,
    )
    return {name: time.divide_by(CALLS).median for name, time in timings.items()}


# The report


def find_fastest_mujoco(times: dict[str, Any]) -> tuple[str, float]:
    """Return name and time per step [s] of MuJoCo's fastest integrator."""
    medians = {name: t["median"] for name, t in times.items() if name.startswith("MuJoCo")}
    name = min(medians, key=medians.__getitem__)
    return name, medians[name]


def draw_figures(figures: dict[str, Any], folder: Path) -> None:
    """Draw the time of a step over the number of joints."""
    arms = list(figures["arms"].values())
    joints = [arm["joints"] for arm in arms]
    figure = make_figure(7.5, 5.5)
    axes = figure.subplots()
    styles = {**{name: (colour, "o") for name, colour in COLOURS.items()}, **PEERS}
    for name in arms[0]["times"]:
        colour, marker = styles[name]
        times = [arm["times"][name]["median"] * 1e9 for arm in arms]
        axes.loglog(joints, times, color=colour, marker=marker, label=name)
    axes.set_xticks(joints, [str(n) for n in joints])
    axes.minorticks_off()
    axes.set_xlabel("joints")
    axes.set_ylabel("time per step [ns]")
    axes.grid(True, color="0.9", linewidth=0.8)
    figure.legend(loc="outside right upper", frameon=False)
    save_picture(figure, folder, "ns_per_step")


def write_report(figures: dict[str, Any]) -> str:
    """Return the section in Markdown."""
    arms = figures["arms"]
    names = list(next(iter(arms.values()))["times"])
    lines = [
        "One integration step of each machine stripped to what the peers have, too (motors, gears, "
        "links under gravity; three_axis has none): no brakes, end stops, current loops, sticking "
        "friction (bench/speed/bare.py). README.md has a step of each scene as shipped. Voltages "
        "held, medians of interleaved repetitions with half the distance of the quartiles. "
        "Ours is timed in `Plant.run` over 20 000 steps, MuJoCo in one "
        "`mj_step(model, data, nstep=2000)` on the same machine. Beyond 12 joints our recursions "
        "are loops and no longer unrolled. The chains of 12 and 24 links carry the motors and "
        "gears of three_axis (bench/speed/chains.py).",
        "",
    ]
    rows = []
    for name in names:
        times = [WallTime(**arm["times"][name]) for arm in arms.values()]
        cells = (f"{timing.median * 1e9:.4g} ± {100 * timing.spread:.0f} %" for timing in times)
        rows.append((name, *cells))
    for scheme in STEPS:
        if scheme in names:
            ratios = (find_fastest_mujoco(arm["times"])[1] / arm["times"][scheme]["median"]
                      for arm in arms.values())  # fmt: skip
            rows.append((f"MuJoCo's fastest / {scheme}", *(f"{ratio:.1f}" for ratio in ratios)))
    lines.append(
        format_table(("[ns]", *(f"{n}, N = {a['joints']}" for n, a in arms.items())), rows)
    )
    calls = {name: f"{seconds * 1e6:.1f} us" for name, seconds in figures["python_call"].items()}
    lines += [
        "",
        "A call from Python per servo period costs beside its steps: "
        + ", ".join(f"`{name}` {cost}" for name, cost in calls.items())
        + " (three_axis; of `Plant.advance` most is the check of the voltages).",
        "",
        "![Time per step over the number of joints](ns_per_step.png)",
    ]
    return "\n".join(lines)
