"""Error after one second of motion against the wall time that it takes."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator import Diverged, Plant, Scene, load_scene
from arm_emulator.analysis.reference import reference
from arm_emulator.machine.schemes.known import SCHEMES
from bench.bare import BARE
from bench.measure import Task, compile_all, interleaved, progress, side_by_side, without_collector
from bench.measure import wall as wall_time
from bench.motion import SERVO_PERIOD, sines
from bench.mujoco_peer import INTEGRATORS, MujocoArm
from bench.time_at_error import time_at_error
from bench.work_precision_report import FROM_PYTHON, INPUTS, draw, report

TITLE = "Work and precision"

__all__ = ["TITLE", "draw", "report", "run"]  # of a section

Array = NDArray[np.float64]

FACTORS = (1.0, 0.5, 0.2)  # of the decades of the step
TARGETS = (1e-4, 1e-5, 1e-6, 1e-8)  # rad
AGREEMENT = 1e-6  # rad; beyond this the two machines are not the same
SCIPY_METHODS = ("RK45", "LSODA")
# Wall time of a step per joint, a guess for planning only [s].
GUESS = 20e-9  # of any of our schemes
GUESS_MUJOCO = {"implicit": 1.1e-6, "RK4": 2.0e-6}
GUESS_MUJOCO_OTHERS = 0.65e-6


@dataclass(frozen=True)
class Case:
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
    "three_axis": Case("three_axis", "three_axis", ours=1e-7, longest=2.5, rtol=(1e-3, 1e-5, 1e-7)),
    "ur5": Case("ur5, gravity", "ur5", rtol=(1e-3, 1e-5, 1e-7)),
    "panda": Case("panda, gravity", "panda", rtol=(1e-3, 1e-5, 1e-7)),
    "three_axis_10ms": Case(
        "three_axis, voltages held for 10 ms", "three_axis", period=1e-2, ours=1e-6, theirs=1e-5
    ),
    "three_axis_no_inductance": Case(
        "three_axis without inductance",
        "three_axis",
        {"joints.*.motor.inductance": None},
        ours=1e-5,
        theirs=1e-4,
    ),
}


def run(quick: bool) -> dict[str, Any]:
    """Measure all cases."""
    cases = dict(list(CASES.items())[:1] + list(CASES.items())[-1:]) if quick else CASES
    scenes = {
        (key, scheme): _scene(case, scheme, case.period)
        for key, case in cases.items()
        for scheme in SCHEMES
    }
    compile_all(scenes.values())
    motions = [(key, seed) for key in cases for seed in range(INPUTS)]
    truths = dict(zip(motions, side_by_side("reference", _truth, motions), strict=True))
    return {
        key: _measure(
            case,
            {scheme: scenes[key, scheme] for scheme in SCHEMES},
            [truths[key, seed] for seed in range(INPUTS)],
            quick,
        )
        for key, case in cases.items()
    }


def _truth(motion: tuple[str, int]) -> Array:
    key, seed = motion
    case = CASES[key]
    scene = _scene(case, "rosenbrock", case.period)
    end: Array = reference(scene, sines(len(scene.joints), seed, case.period), case.period)[-1]
    return end


def _scene(case: Case, scheme: str, dt: float) -> Scene:
    own = {"servo_period": case.period, "integrator.scheme": scheme, "integrator.dt": dt}
    return load_scene(case.scene, {**BARE, **case.overrides, **own})


def steps_of(largest: float, smallest: float) -> list[float]:
    """Return step sizes from `largest` to `smallest` [s], three in a decade, dividing `largest`."""
    decades = round(math.log10(largest / smallest))
    sizes = [largest * f / 10**d for d in range(decades + 1) for f in FACTORS]
    return [float(f"{dt:.6g}") for dt in sizes if dt > 0.99 * smallest]


class _Series:
    """One way to compute the motion, at one step size: times it, keeps what came out."""

    def __init__(self, name: str, dt: float, about: float, work: Callable[[int], Array]) -> None:
        self.name, self.dt, self.about = name, dt, about
        self._work = work
        self.ends: dict[int, Array | None] = {}

    def task(self, prepare: Callable[[], object]) -> Task:
        return Task(self.work, lambda repetition: prepare(), self.about)

    def work(self, repetition: int) -> None:
        self.ends[repetition] = None
        with contextlib.suppress(Diverged, PeerDiverged):
            self.ends[repetition] = self._work(repetition)


def _measure(
    case: Case, scenes: Mapping[str, Scene], truths: list[Array], quick: bool
) -> dict[str, Any]:
    scene = scenes["rosenbrock"]
    N = len(scene.joints)
    voltages = [sines(N, seed, case.period) for seed in range(INPUTS)]
    agreement = _agreement(case, scene, voltages[0], truths[0])

    smallest, theirs = (case.ours, case.theirs) if not quick else (1e-6, 1e-5)
    series: list[_Series] = []
    tasks: dict[str, Task] = {}

    def add(one: _Series, prepare: Callable[[], object]) -> None:
        series.append(one)
        tasks[f"{one.name}, {one.dt:g} s"] = one.task(prepare)

    for scheme in SCHEMES:
        for dt in steps_of(case.period, smallest):
            plant = Plant(_scene(case, scheme, dt))
            about = GUESS * N / dt
            add(_Series(scheme, dt, about, _run_plant(plant, voltages, case)), plant.reset)
            if scheme == "rosenbrock" and dt >= 1e-5:
                ticks = 4e-6 / case.period
                one = _Series(FROM_PYTHON, dt, about + ticks, _call_plant(plant, voltages, case))
                add(one, plant.reset)
    for integrator in INTEGRATORS:
        guess = GUESS_MUJOCO.get(integrator, GUESS_MUJOCO_OTHERS)
        for dt in steps_of(case.period, theirs):
            if guess * N / dt > case.longest:
                continue
            arm = MujocoArm(scene, integrator, dt)
            name = f"MuJoCo {integrator}"
            one = _Series(name, dt, guess * N / dt, _run_mujoco(arm, voltages, case))
            add(one, arm.reset)

    with progress("work and precision", len(tasks) * INPUTS) as done:
        timings = interleaved(tasks, INPUTS, lambda name: done(f"{case.title}: {name}"))
    points: dict[str, list[dict[str, Any]]] = {}
    for one in series:
        errors = [
            None if end is None else float(np.abs(end - truth).max())
            for truth, end in ((truths[k], one.ends[k]) for k in range(INPUTS))
        ]
        points.setdefault(one.name, []).append(
            {
                "dt": one.dt,
                "error": _rms(errors),
                "errors": errors,
                "time": asdict(timings[f"{one.name}, {one.dt:g} s"]),
            }
        )
    if not quick:
        points |= _scipy(case, scene, voltages[0], truths[0])
    return {
        "title": case.title,
        "period": case.period,
        "agreement": agreement,
        "series": points,
        "at_error": {f"{target:g}": _at_error(points, target) for target in TARGETS},
        "faster_below": {kind: _faster_below(points, kind) for kind in ("mujoco", "scipy")},
    }


def _run_plant(plant: Plant, voltages: list[Array], case: Case) -> Callable[[int], Array]:
    steps = round(case.period / plant.scene.integrator.dt)
    return lambda repetition: plant.run(voltages[repetition], steps)[-1]


def _call_plant(plant: Plant, voltages: list[Array], case: Case) -> Callable[[int], Array]:
    steps = round(case.period / plant.scene.integrator.dt)

    def work(repetition: int) -> Array:
        for row in voltages[repetition]:
            plant.advance(row, steps)
        return plant.state.q

    return work


class PeerDiverged(RuntimeError):
    """MuJoCo has left the world of sound motions."""


def _run_mujoco(arm: MujocoArm, voltages: list[Array], case: Case) -> Callable[[int], Array]:
    steps = round(case.period / arm.model.opt.timestep)

    def work(repetition: int) -> Array:
        arm.run(voltages[repetition], steps)
        if arm.diverged:
            raise PeerDiverged
        return arm.q

    return work


def _agreement(case: Case, scene: Scene, voltages: Array, truth: Array) -> dict[str, Any]:
    """Check that MuJoCo's machine and ours are one: both against the reference after 1 s.

    With inductance MuJoCo's error is of first order in the step, so twice the result at h less the
    one at 2 h leaves an error of second order.
    """
    h = 1e-5
    ends = []
    for dt in (h, 2 * h):
        arm = MujocoArm(scene, "RK4", dt)
        arm.run(voltages, round(case.period / dt))
        ends.append(arm.q)
    plant = Plant(_scene(case, "rosenbrock", h))
    ours = plant.run(voltages, round(case.period / h))[-1]
    mujoco = float(np.abs(2.0 * ends[0] - ends[1] - truth).max())
    emulator = float(np.abs(ours - truth).max())
    return {
        "mujoco": mujoco,
        "ours": emulator,
        "agree": max(mujoco, emulator) < AGREEMENT,
    }


def _scipy(case: Case, scene: Scene, voltages: Array, truth: Array) -> dict[str, Any]:
    """Time Pinocchio's dynamics in SciPy's integrators, once each: they take seconds."""
    points: dict[str, list[dict[str, Any]]] = {}
    runs = [(method, rtol) for method in SCIPY_METHODS for rtol in case.rtol]
    with progress("Pinocchio + SciPy", len(runs)) as done, without_collector():
        for method, rtol in runs:
            end: list[Array] = []

            def work(_: int, method: str = method, rtol: float = rtol, end: Any = end) -> None:
                end.append(reference(scene, voltages, case.period, rtol, method=method)[-1])

            wall = wall_time(work)
            error = float(np.abs(end[0] - truth).max())
            time = {"median": wall, "low": wall, "high": wall, "repetitions": 1}
            points.setdefault(f"Pinocchio + SciPy {method}", []).append(
                {"rtol": rtol, "error": error, "errors": [error], "time": time}
            )
            done(f"{case.title}: {method}, rtol {rtol:g}")
    return points


def _rms(errors: list[float | None]) -> float | None:
    if any(error is None or not math.isfinite(error) for error in errors):
        return None
    return math.sqrt(sum(error**2 for error in errors if error is not None) / len(errors))


def _faster_below(points: Mapping[str, list[dict[str, Any]]], kind: str) -> float | None:
    """Return the error below which `kind`'s best is faster than ours; None: it never is."""
    for exponent in np.arange(-4.0, -13.0, -0.1):
        at = _at_error(points, 10.0**exponent)
        ours, theirs = at["ours"], at[kind]
        if theirs and (ours is None or theirs["time"] < ours["time"]):
            return float(10.0**exponent)
    return None


def _at_error(points: Mapping[str, list[dict[str, Any]]], target: float) -> dict[str, Any]:
    times = {name: time_at_error(values, target) for name, values in points.items()}
    reached = {name: time for name, time in times.items() if time is not None}

    def best(choose: Callable[[str], bool]) -> dict[str, Any] | None:
        names = [name for name in reached if choose(name)]
        if not names:
            return None
        name = min(names, key=reached.__getitem__)
        return {"name": name, "time": reached[name]}

    ours, mujoco = best(lambda n: n in SCHEMES), best(lambda n: n.startswith("MuJoCo"))
    return {
        "ours": ours,
        "ours_from_python": best(lambda n: n == FROM_PYTHON),
        "mujoco": mujoco,
        "scipy": best(lambda n: n.startswith("Pinocchio")),
        "ratio": mujoco["time"] / ours["time"] if ours and mujoco else None,
    }
