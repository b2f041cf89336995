"""Many arms side by side, beside one arm and beside MuJoCo's rollout."""

from __future__ import annotations

import math
import os
import runpy
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator import Plant, Scene, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.machine.schemes.known import SCHEMES
from arm_emulator_fleet import Fleet
from bench.measure import Task, measure_interleaved, show_progress
from bench.pictures import COLOURS, make_figure, save_picture
from bench.reference_motions import SERVO_PERIOD, make_sines
from bench.speed.bare import BARE
from bench.speed.mujoco_peer import INTEGRATORS, MujocoArm, end_of, import_mujoco
from bench.speed.work_precision import list_steps
from bench.tables import format_table
from oracles.reference import solve_positions

TITLE = "Many arms"


COUNT = 64  # arms
ARMS = ("three_axis", "ur5", "panda")
PEER = "ur5"  # for the comparison with rollout
STEPS_PER_PERIOD = 2
INPUTS = 3  # motions; the error is the root mean square over them
TARGET = 1e-5  # rad, the largest error
COARSEST, FINEST, FINEST_THEIRS = SERVO_PERIOD, 2e-5, 1e-5  # s
PART = 20  # of the second, that rollout is timed for: each of its steps takes the same
EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "vector_env.py"
ENV_ARMS, ENV_STEPS, ENV_TICKS = 1024, 40, 10  # the arms' episodes have 20 steps of 10 ticks
CHUNK = 2000  # steps of one call of rollout: of its states, which it keeps, some 30 MB


def run_bench(quick: bool) -> dict[str, Any]:
    """Measure throughput of every arm, then time per step and time at an error."""
    repetitions = 3 if quick else 9
    cores = len(os.sched_getaffinity(0))
    figures: dict[str, Any] = {"cores": cores, "count": COUNT, "throughput": {}}
    with show_progress("many arms", repetitions * len(ARMS) * len(SCHEMES)) as done:
        for name in ARMS:
            figures["throughput"][name] = {
                scheme: _measure_throughput(name, scheme, repetitions, done) for scheme in SCHEMES
            }
    figures["per_step"] = _measure_per_step(repetitions)
    figures["at_error"] = _measure_at_error(quick)
    figures["environment"] = _measure_environment(repetitions)
    return figures


def make_bare_scene(name: str, scheme: str, dt: float) -> Scene:
    """Return an arm without the parts that MuJoCo lacks."""
    return load_scene(
        name,
        {
            **BARE,
            "servo_period": SERVO_PERIOD,
            "integrator.scheme": scheme,
            "integrator.dt": dt,
        },
    )


def _measure_throughput(
    name: str, scheme: str, repetitions: int, done: Callable[[str], None]
) -> dict[str, Any]:
    """Return arm-steps per second: of one arm, and of a fleet on one core and on all."""
    scene = make_bare_scene(name, scheme, SERVO_PERIOD / STEPS_PER_PERIOD)
    N = len(scene.joints)
    single = make_sines(N, 0)
    rows = np.stack([make_sines(N, arm, duration=0.5) for arm in range(COUNT)], axis=1)
    plant, fleet, wide = Plant(scene), Fleet(scene, COUNT, workers=1), Fleet(scene, COUNT)
    tasks = {
        "one arm": _make_task(plant, single),
        "one core": _make_task(fleet, rows),
        "all cores": _make_task(wide, rows),
    }
    timings = measure_interleaved(
        tasks, repetitions, lambda task: done(name) if task == "one arm" else None
    )
    steps = {"one arm": len(single), "one core": rows.size // N, "all cores": rows.size // N}
    per_step = {
        task: asdict(timing.divide_by(steps[task] * STEPS_PER_PERIOD))
        for task, timing in timings.items()
    }
    return {"lanes": fleet.lanes, "per_step": per_step}


class Rollout:
    """MuJoCo's arms of one model, on some threads.

    Args:
        scene: of all arms.
        integrator: one of `INTEGRATORS`.
        dt: step [s].
        count: of arms.
        threads: of its pool.
    """

    def __init__(self, scene: Scene, integrator: str, dt: float, count: int, threads: int) -> None:
        from mujoco import rollout

        self.arm = MujocoArm(scene, integrator, dt)
        self.model, self.count = self.arm.model, count
        self._data = [import_mujoco().MjData(self.model) for _ in range(threads)]
        self._pool = rollout.Rollout(nthread=threads)
        self._kind = import_mujoco().mjtState.mjSTATE_FULLPHYSICS
        self._size = import_mujoco().mj_stateSize(self.model, self._kind)
        self._driven = [k for k, joint in enumerate(scene.joints) if joint.motor is not None]
        self.reset()

    def reset(self) -> None:
        """Put all arms at the start."""
        self.arm.reset()
        state = np.empty(self._size)
        import_mujoco().mj_getState(self.model, self.arm.data, state, self._kind)
        self._state = np.tile(state, (self.count, 1))

    def run(self, voltages: Array, steps: int) -> None:
        """Hold each row of voltages (K, count, N) [V] for `steps` steps."""
        rows = max(1, CHUNK // steps)
        for first in range(0, len(voltages), rows):
            zoh = voltages[first : first + rows, :, self._driven].transpose(1, 0, 2)
            control = np.repeat(zoh, steps, axis=1)
            states, _ = self._pool.rollout(self.model, self._data, self._state, control)
            self._state = states[:, -1].copy()


def _make_task(
    machine: Plant | Fleet | Rollout, rows: Array, steps: int = STEPS_PER_PERIOD
) -> Task:
    return Task(lambda _: machine.run(rows, steps), lambda _: machine.reset())


def _measure_per_step(repetitions: int) -> dict[str, Any]:
    """Return the time of a step of one arm of many [s], on one core."""
    dt = SERVO_PERIOD / STEPS_PER_PERIOD
    scenes = {scheme: make_bare_scene(PEER, scheme, dt) for scheme in SCHEMES}
    N = len(scenes["paper"].joints)
    rows = np.stack([make_sines(N, arm, duration=0.5) for arm in range(COUNT)], axis=1)
    few = np.ascontiguousarray(rows[:20])
    tasks: dict[str, Task] = {}
    for scheme, scene in scenes.items():
        fleet = Fleet(scene, COUNT, workers=1)
        tasks[scheme] = _make_task(fleet, rows)
    for integrator in INTEGRATORS:
        peer = Rollout(scenes["paper"], integrator, dt, COUNT, threads=1)
        tasks[f"MuJoCo {integrator}"] = _make_task(peer, few)
    with show_progress("per step", repetitions * len(tasks)) as done:
        timings = measure_interleaved(tasks, repetitions, done)
    return {
        task: asdict(
            timing.divide_by((few if task not in SCHEMES else rows).size / N * STEPS_PER_PERIOD)
        )
        for task, timing in timings.items()
    }


def _measure_environment(repetitions: int) -> dict[str, Any]:
    """Return the time of a step of one arm of examples/vector_env.py [s], by where the arms are."""
    make = runpy.run_path(str(EXAMPLE))["ReachEnv"]
    actions = np.random.default_rng(1).uniform(-0.3, 0.3, (ENV_STEPS, ENV_ARMS, 3))
    tasks: dict[str, Task] = {}
    for place, device in (("lanes", None), ("kernels on the processor", "processor")):
        env = make("three_axis", ENV_ARMS, ticks=ENV_TICKS, device=device)

        def play_episode(_: object, env: Any = env) -> None:
            for action in actions:
                env.step(action)

        def reset_environment(_: object, env: Any = env) -> None:
            env.reset(seed=1)

        tasks[place] = Task(play_episode, reset_environment)
    with show_progress("environment", repetitions) as done:
        timings = measure_interleaved(
            tasks, repetitions, lambda task: done(task) if task == "lanes" else None
        )
    return {
        task: asdict(timing.divide_by(ENV_STEPS * ENV_ARMS)) for task, timing in timings.items()
    }


def _measure_at_error(quick: bool) -> dict[str, Any]:
    """Return the wall time of a simulated second of one arm of many at an error of `TARGET`.

    On one core, by the largest step that keeps the error.
    """
    scene = make_bare_scene(PEER, "rosenbrock", SERVO_PERIOD)
    inputs = [make_sines(len(scene.joints), seed) for seed in range(INPUTS)]
    truths = [solve_positions(scene, rows, SERVO_PERIOD)[-1] for rows in inputs]
    rows = np.stack([inputs[arm % INPUTS] for arm in range(COUNT)], axis=1)
    part = np.ascontiguousarray(rows[: len(rows) // PART])

    def is_exact(machine: Plant | MujocoArm, steps: int) -> bool:
        errors = []
        for voltages, truth in zip(inputs, truths, strict=True):
            machine.reset()
            end = end_of(machine, voltages, steps)
            errors.append(math.inf if end is None else float(np.abs(end - truth).max()))
        return math.sqrt(sum(error**2 for error in errors) / INPUTS) <= TARGET

    tasks: dict[str, Task] = {}
    integrators = INTEGRATORS[-2:] if quick else INTEGRATORS
    with show_progress("steps at an error", len(SCHEMES) + len(integrators)) as done:
        for scheme in SCHEMES:
            for dt in list_steps(COARSEST, FINEST):
                steps, own = round(SERVO_PERIOD / dt), make_bare_scene(PEER, scheme, dt)
                if is_exact(Plant(own), steps):
                    tasks[scheme] = _make_task(Fleet(own, COUNT, workers=1), rows, steps)
                    break
            done(scheme)
        for integrator in integrators:
            for dt in list_steps(COARSEST, FINEST_THEIRS):
                steps = round(SERVO_PERIOD / dt)
                if is_exact(MujocoArm(scene, integrator, dt), steps):
                    peer = Rollout(scene, integrator, dt, COUNT, threads=1)
                    tasks[f"MuJoCo {integrator}"] = _make_task(peer, part, steps)
                    break
            done(integrator)
    with show_progress("time at an error", len(tasks) * (1 if quick else 3)) as done:
        timings = measure_interleaved(tasks, 1 if quick else 3, done)
    return {
        "target": TARGET,
        "times": {
            name: timing.divide_by(COUNT if name in SCHEMES else COUNT / PART).median
            for name, timing in timings.items()
        },
    }


# The report


def _choose_best(times: dict[str, float], theirs: bool) -> tuple[str, float]:
    name = min((n for n in times if (n in SCHEMES) != theirs), key=times.__getitem__)
    return name, times[name]


def compare_per_step(figures: dict[str, Any]) -> tuple[str, str, float]:
    """Return MuJoCo's quickest, ours, and how many times longer its step takes."""
    times = {name: timing["median"] for name, timing in figures["per_step"].items()}
    (ours, own), (peer, peer_result) = _choose_best(times, False), _choose_best(times, True)
    return peer, ours, peer_result / own


def compare_at_error(figures: dict[str, Any]) -> tuple[str, str, float] | None:
    """Return the same for the time at the error; None if one of them does not get there."""
    times = figures["at_error"]["times"]
    if not set(times) & set(SCHEMES) or not set(times) - set(SCHEMES):
        return None
    (ours, own), (peer, peer_result) = _choose_best(times, False), _choose_best(times, True)
    return peer, ours, peer_result / own


def compare_lanes(figures: dict[str, Any], arm: str, scheme: str) -> float:
    """Return how many times the arm-steps of one arm a fleet takes on one core."""
    per_step = figures["throughput"][arm][scheme]["per_step"]
    return float(per_step["one arm"]["median"] / per_step["one core"]["median"])


def write_report(figures: dict[str, Any]) -> str:
    """Return the section in Markdown."""
    lines = [
        f"A `Fleet` of {figures['count']} arms, each with voltages of its own, {STEPS_PER_PERIOD} "
        f"steps in a servo period of {SERVO_PERIOD * 1e3:g} ms: nanoseconds of one step of one "
        f"arm, on one core and on all {figures['cores']}.",
        "",
    ]
    rows = []
    for arm, schemes in figures["throughput"].items():
        for scheme, of in schemes.items():
            times = of["per_step"]
            alone, core, cores = (
                1e9 * of["per_step"][task]["median"]
                for task in ("one arm", "one core", "all cores")
            )
            rows.append((arm, scheme, of["lanes"], f"{alone:.1f}",
                         f"{core:.1f}", f"{alone / core:.2f}",
                         f"{cores:.1f}", f"{alone / cores:.2f}"))  # fmt: skip
    heads = ("arm", "scheme", "lanes", "one arm", "fleet, one core", "times", "fleet, all cores",
             "times")  # fmt: skip
    peer, ours, ratio = compare_per_step(figures)
    per_step = [(n, f"{1e9 * of['median']:.1f}") for n, of in figures["per_step"].items()]
    times = sorted(figures["at_error"]["times"].items(), key=lambda item: item[1])
    lines += [
        format_table(heads, rows),
        "",
        f"MuJoCo's `rollout` of as many {PEER}, each on one core (two that share a processor with "
        "others are seldom equally fast), a step of one arm:",
        "",
        format_table(("", "ns"), per_step),
        "",
        f"Its quickest, {peer}, takes {ratio:.0f} times as long as {ours}. A simulated second of "
        f"one arm at an error of {figures['at_error']['target']:g} rad:",
        "",
        format_table(("", "us"), [(name, f"{time * 1e6:.1f}") for name, time in times]),
        "",
    ]
    if (at := compare_at_error(figures)) is not None:
        lines += [f"There {at[0]} takes {at[2]:.0f} times as long as {at[1]}.", ""]
    if "environment" in figures:
        times = {place: timing["median"] for place, timing in figures["environment"].items()}
        own, device = times.values()
        lines += [
            f"The environment of examples/vector_env.py with {ENV_ARMS} arms, on all cores, a step "
            f"of {ENV_TICKS} servo periods and the resets of ended episodes: {1 / own:.2g} steps/s "
            f"in lanes. The kernels of a card, as loops of the processor, take {device / own:.2f} "
            "times as long.",
            "",
        ]
    lines += ["![Arm-steps per second](fleet.png)", ""]
    return "\n".join(lines)


def draw_figures(figures: dict[str, Any], folder: Path) -> None:
    """Draw arm-steps per second of one arm and of fleets."""
    figure = make_figure(10.0, 4.2)
    arms = list(figures["throughput"])
    panels = figure.subplots(1, len(arms), sharey=True, squeeze=False)[0]
    rates_of = ("one arm", "one core", "all cores")
    for axes, arm in zip(panels, arms, strict=True):
        schemes = figures["throughput"][arm]
        width = 0.8 / len(schemes)
        for k, (scheme, of) in enumerate(schemes.items()):
            rates = [1e-6 / of["per_step"][kind]["median"] for kind in rates_of]
            at = np.arange(len(rates_of)) + width * (k - 0.5 * (len(schemes) - 1))
            axes.bar(at, rates, width=0.9 * width, color=COLOURS[scheme], label=scheme)
        axes.set_xticks(range(len(rates_of)), ("one arm", "fleet,\none core", "fleet,\nall cores"))
        axes.set_title(arm)
        axes.grid(True, axis="y", color="0.9", linewidth=0.8)
        axes.set_axisbelow(True)
    panels[0].set_ylabel("million arm-steps per second")
    panels[-1].legend(frameon=False)
    save_picture(figure, folder, "fleet")
