"""Error after one second of motion against the wall time that it takes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from arm_emulator import Plant, Scene, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.machine.schemes.known import SCHEMES
from bench.measure import (
    Task,
    compile_all,
    make_wall_time,
    map_on_all_cores,
    measure_interleaved,
    pause_collector,
    show_progress,
)
from bench.reference_motions import SERVO_PERIOD, make_sines
from bench.speed.bare import BARE
from bench.speed.mujoco_peer import INTEGRATORS, MujocoArm, end_of
from bench.speed.work_precision_report import FROM_PYTHON, INPUTS, draw_figures, write_report
from oracles.reference import solve_positions

TITLE = "Work and precision"

__all__ = ["TITLE", "draw_figures", "run_bench", "write_report"]  # of a section

FACTORS = (1.0, 0.5, 0.2)  # of the decades of the step
TARGETS = (1e-4, 1e-5, 1e-6, 1e-8)  # rad
AGREEMENT = 1e-6  # rad; beyond this the two machines are not the same
SCIPY_METHODS = ("RK45", "LSODA")
# Wall time of a step per joint, a guess for planning only [s].
GUESS = 20e-9  # of any of our schemes
GUESS_MUJOCO = {"implicit": 1.1e-6, "RK4": 2.0e-6}
GUESS_MUJOCO_OTHERS = 0.65e-6


@dataclass(frozen=True)
class MotionCase:
    """A machine and how it is driven."""

    title: str
    scene: str
    overrides: Mapping[str, Any] = field(default_factory=dict)
    period: float = SERVO_PERIOD  # s, over which a voltage is held
    ours: float = 1e-6  # s, our smallest step
    theirs: float = 1e-6  # s, MuJoCo's smallest step
    longest: float = 1.0  # s; a run of MuJoCo that would take longer is left out
    rtol: tuple[float, ...] = ()  # of SciPy's methods


CASES = {
    "three_axis": MotionCase(
        "three_axis", "three_axis", ours=1e-7, longest=2.5, rtol=(1e-3, 1e-5, 1e-7)
    ),
    "ur5": MotionCase("ur5, gravity", "ur5", rtol=(1e-3, 1e-5, 1e-7)),
    "panda": MotionCase("panda, gravity", "panda", rtol=(1e-3, 1e-5, 1e-7)),
    "three_axis_10ms": MotionCase(
        "three_axis, voltages held for 10 ms", "three_axis", period=1e-2, ours=1e-6, theirs=1e-5
    ),
    "three_axis_no_inductance": MotionCase(
        "three_axis without inductance",
        "three_axis",
        {"joints.*.motor.inductance": None},
        ours=1e-5,
        theirs=1e-4,
    ),
}


def run_bench(quick: bool) -> dict[str, Any]:
    """Measure all cases."""
    cases = dict(list(CASES.items())[:1] + list(CASES.items())[-1:]) if quick else CASES
    scenes = {
        (key, scheme): _load_scene(case, scheme, case.period)
        for key, case in cases.items()
        for scheme in SCHEMES
    }
    compile_all(scenes.values())
    motions = [(key, seed) for key in cases for seed in range(INPUTS)]
    truths = dict(zip(motions, map_on_all_cores("reference", _compute_truth, motions), strict=True))
    return {
        key: _measure_case(
            case,
            {scheme: scenes[key, scheme] for scheme in SCHEMES},
            [truths[key, seed] for seed in range(INPUTS)],
            quick,
        )
        for key, case in cases.items()
    }


def _compute_truth(motion: tuple[str, int]) -> Array:
    key, seed = motion
    case = CASES[key]
    scene = _load_scene(case, "rosenbrock", case.period)
    end: Array = solve_positions(
        scene, make_sines(len(scene.joints), seed, case.period), case.period
    )[-1]
    return end


def _load_scene(case: MotionCase, scheme: str, dt: float) -> Scene:
    own = {"servo_period": case.period, "integrator.scheme": scheme, "integrator.dt": dt}
    return load_scene(case.scene, {**BARE, **case.overrides, **own})


def list_steps(largest: float, smallest: float) -> list[float]:
    """Return step sizes from `largest` to `smallest` [s], three in a decade, dividing `largest`."""
    decades = round(math.log10(largest / smallest))
    sizes = [largest * f / 10**d for d in range(decades + 1) for f in FACTORS]
    return [float(f"{dt:.6g}") for dt in sizes if dt > 0.99 * smallest]


@dataclass
class _Series:
    """One way to compute the motions, at one step size: times it, keeps what came out."""

    name: str
    dt: float  # s
    about: float  # s
    machine: Plant | MujocoArm
    called: bool = False  # from Python in every period
    ends: dict[int, Array | None] = field(default_factory=dict)

    def make_task(self, voltages: list[Array], period: float) -> Task:
        """Return the task of a motion, the `repetition`th of the voltages."""
        steps, machine = round(period / self.dt), self.machine

        def run_steps(repetition: int) -> None:
            rows = voltages[repetition]
            if self.called:
                assert isinstance(machine, Plant)
                for row in rows:
                    machine.advance(row, steps)
                self.ends[repetition] = machine.state.q
            else:
                self.ends[repetition] = end_of(machine, rows, steps)

        return Task(run_steps, lambda _: machine.reset(), self.about)


def _measure_case(
    case: MotionCase, scenes: Mapping[str, Scene], truths: list[Array], quick: bool
) -> dict[str, Any]:
    scene = scenes["rosenbrock"]
    N = len(scene.joints)
    voltages = [make_sines(N, seed, case.period) for seed in range(INPUTS)]
    smallest, theirs = (case.ours, case.theirs) if not quick else (1e-6, 1e-5)
    series: list[_Series] = []
    for scheme in SCHEMES:
        for dt in list_steps(case.period, smallest):
            plant, about = Plant(_load_scene(case, scheme, dt)), GUESS * N / dt
            series.append(_Series(scheme, dt, about, plant))
            if scheme == "rosenbrock" and dt >= 1e-5:
                calls = 4e-6 / case.period
                series.append(_Series(FROM_PYTHON, dt, about + calls, plant, called=True))
    for integrator in INTEGRATORS:
        for dt in list_steps(case.period, theirs):
            about = GUESS_MUJOCO.get(integrator, GUESS_MUJOCO_OTHERS) * N / dt
            if about <= case.longest:
                arm = MujocoArm(scene, integrator, dt)
                series.append(_Series(f"MuJoCo {integrator}", dt, about, arm))

    tasks = {
        f"{peer_series.name}, {peer_series.dt:g} s": peer_series.make_task(voltages, case.period)
        for peer_series in series
    }
    with show_progress("work and precision", len(tasks) * INPUTS) as done:
        timings = measure_interleaved(tasks, INPUTS, lambda name: done(f"{case.title}: {name}"))
    points: dict[str, list[dict[str, Any]]] = {}
    for series_of in series:
        errors = [
            None if (end := series_of.ends[k]) is None else float(np.abs(end - truth).max())
            for k, truth in enumerate(truths)
        ]
        points.setdefault(series_of.name, []).append(
            {
                "dt": series_of.dt,
                "error": _compute_rms(errors),
                "errors": errors,
                "time": asdict(timings[f"{series_of.name}, {series_of.dt:g} s"]),
            }
        )
    if not quick:
        points |= _measure_scipy(case, scene, voltages[0], truths[0])
    return {
        "title": case.title,
        "period": case.period,
        "agreement": _check_agreement(case, scene, voltages[0], truths[0]),
        "series": points,
        "at_error": {f"{target:g}": _compare_at_error(points, target) for target in TARGETS},
        "faster_below": {kind: _find_faster_below(points, kind) for kind in ("mujoco", "scipy")},
    }


def _check_agreement(
    case: MotionCase, scene: Scene, voltages: Array, truth: Array
) -> dict[str, Any]:
    """Check that MuJoCo's machine and ours are one: both against the reference after 1 s.

    With inductance MuJoCo's error is of first order in the step. Twice the result at h less the one
    at 2 h therefore leaves an error of second order.
    """
    h = 1e-5
    ends = []
    for dt in (h, 2 * h):
        arm = MujocoArm(scene, "RK4", dt)
        arm.run(voltages, round(case.period / dt))
        ends.append(arm.q)
    own = Plant(_load_scene(case, "rosenbrock", h)).run(voltages, round(case.period / h))[-1]
    mujoco = float(np.abs(2.0 * ends[0] - ends[1] - truth).max())
    ours = float(np.abs(own - truth).max())
    return {"mujoco": mujoco, "ours": ours, "agree": max(mujoco, ours) < AGREEMENT}


def _measure_scipy(case: MotionCase, scene: Scene, voltages: Array, truth: Array) -> dict[str, Any]:
    """Time Pinocchio's dynamics in SciPy's integrators, once each: they take seconds."""
    points: dict[str, list[dict[str, Any]]] = {}
    runs = [(method, rtol) for method in SCIPY_METHODS for rtol in case.rtol]
    with show_progress("Pinocchio + SciPy", len(runs)) as done, pause_collector():
        for method, rtol in runs:
            began = time.perf_counter()
            end = solve_positions(scene, voltages, case.period, rtol, method=method)[-1]
            spent, error = (
                make_wall_time([time.perf_counter() - began]),
                float(np.abs(end - truth).max()),
            )
            points.setdefault(f"Pinocchio + SciPy {method}", []).append(
                {"rtol": rtol, "error": error, "errors": [error], "time": asdict(spent)}
            )
            done(f"{case.title}: {method}, rtol {rtol:g}")
    return points


def _compute_rms(errors: list[float | None]) -> float | None:
    if any(error is None or not math.isfinite(error) for error in errors):
        return None
    return math.sqrt(sum(error**2 for error in errors if error is not None) / len(errors))


def _find_faster_below(points: Mapping[str, list[dict[str, Any]]], kind: str) -> float | None:
    """Return the error below which `kind`'s best is faster than ours; None: it never is."""
    for exponent in np.arange(-4.0, -13.0, -0.1):
        at = _compare_at_error(points, 10.0**exponent)
        ours, theirs = at["ours"], at[kind]
        if theirs and (ours is None or theirs["time"] < ours["time"]):
            return float(10.0**exponent)
    return None


def _compare_at_error(points: Mapping[str, list[dict[str, Any]]], target: float) -> dict[str, Any]:
    times = {name: find_time_at_error(values, target) for name, values in points.items()}
    reached = {name: time for name, time in times.items() if time is not None}

    def find_fastest(choose: Callable[[str], bool]) -> dict[str, Any] | None:
        names = [name for name in reached if choose(name)]
        if not names:
            return None
        name = min(names, key=reached.__getitem__)
        return {"name": name, "time": reached[name]}

    ours, mujoco = (
        find_fastest(lambda n: n in SCHEMES),
        find_fastest(lambda n: n.startswith("MuJoCo")),
    )
    return {
        "ours": ours,
        "ours_from_python": find_fastest(lambda n: n == FROM_PYTHON),
        "mujoco": mujoco,
        "scipy": find_fastest(lambda n: n.startswith("Pinocchio")),
        "ratio": mujoco["time"] / ours["time"] if ours and mujoco else None,
    }


def find_time_at_error(points: list[dict[str, Any]], target: float) -> float | None:
    """Return the wall time [s] at which a series' error falls to `target`, None if it never does.

    Interpolated on the logarithms of error and time. Where the coarsest step is better than that
    already, its time: there is nothing cheaper.
    """
    before = None
    for point in points:
        if point["error"] is None:
            before = None
            continue
        time = point["time"]["median"]
        if point["error"] <= target:
            if before is None:
                return float(time)
            (e0, t0), (e1, t1) = before, (max(point["error"], 1e-300), time)
            share = math.log(e0 / target) / math.log(e0 / e1)
            return float(math.exp(math.log(t0) + share * math.log(t1 / t0)))
        before = point["error"], time
    return None
