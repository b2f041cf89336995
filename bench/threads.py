"""Two threads against one: what the lag costs in accuracy, and what the second core brings."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator import Plant, load_scene
from arm_emulator.analysis.reference import reference
from arm_emulator.build.compiler_command import find_compiler
from bench.chains import chain
from bench.measure import Task, compile_all, interleaved, progress
from bench.motion import Array, sines

TITLE = "Two threads"

STEPS = (1e-3, 1e-4, 1e-5)  # s, of the paper's Table 1
PAPER = {
    1e-3: (0.018696, 0.083323, 0.109300),
    1e-4: (0.004967, 0.006647, 0.013919),
    1e-5: (0.000523, 0.000650, 0.001419),
}
PAPER_RATIO = 0.61
DEPTH = 3
KINDS: dict[str, dict[str, Any]] = {
    "one": {"threads": 1},
    "lag": {"threads": 2, "integrator.exchange": "lag"},
    "predict": {"threads": 2, "integrator.exchange": "predict"},
    "deep": {"threads": 2, "integrator.exchange": "predict", "integrator.exchange_depth": DEPTH},
}
TWO = ("lag", "predict", "deep")  # kinds of two threads
TITLES = {
    "one": "one thread",
    "lag": "lag",
    "predict": "predict",
    "deep": f"predict, depth {DEPTH}",
}
JOINTS = (3, 6, 7, 12, 24, 48)
LOOP_STEPS = 4000  # in one measurement
DT = 1e-5  # s; what a step costs does not depend on it


def run(quick: bool) -> dict[str, Any]:
    """Measure accuracy and time."""
    return {
        "table_1": _table_1(),
        "handshake": [_handshake() for _ in range(5)],
        "loops": _loops((3, 24) if quick else JOINTS, 7 if quick else 21),
        "one_core": _one_core(),
    }


def _table_1() -> dict[str, Any]:
    """Difference between one and two threads after 1 s, and every kind's error."""
    voltages = sines(3, seed=1)
    exact = reference(load_scene("three_axis"), voltages, 1e-3)[-1]
    table: dict[str, Any] = {}
    with progress("Table 1", len(STEPS)) as done:
        for dt in STEPS:
            q = {name: _after(voltages, dt, kind) for name, kind in KINDS.items()}
            table[f"{dt:g}"] = {
                "difference": {k: np.abs(q[k] - q["one"]).tolist() for k in TWO},
                "error": {k: np.abs(q[k] - exact).tolist() for k in KINDS},
            }
            done(f"{dt:g} s")
    return table


def _after(voltages: Array, dt: float, kind: dict[str, Any]) -> Array:
    overrides = {"integrator.scheme": "paper", "integrator.dt": dt, **kind}
    plant = Plant(load_scene("three_axis", overrides=overrides))
    last: Array = plant.run(voltages, plant.scene.steps_per_period)[-1]
    return last


def _loops(joints: tuple[int, ...], repetitions: int) -> dict[str, Any]:
    """Time of one step, of each kind, interleaved."""
    loops: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        scenes = {
            n: {
                name: chain(Path(folder), n, **{"integrator.scheme": "implicit", **kind})
                for name, kind in KINDS.items()
            }
            for n in joints
        }
        compile_all(scene for kinds in scenes.values() for scene in kinds.values())
        with progress("time per loop", len(joints)) as done:
            for n, kinds in scenes.items():
                plants = {name: Plant(scene) for name, scene in kinds.items()}
                timings = interleaved(
                    {name: _task(plant) for name, plant in plants.items()}, repetitions
                )
                loops[str(n)] = {
                    name: asdict(timing.per(LOOP_STEPS)) for name, timing in timings.items()
                }
                done(f"N = {n}")
    return loops


def _task(plant: Plant) -> Task:
    N = len(plant.scene.joints)
    voltage = 3.0 * (-1.0) ** np.arange(N)
    return Task(
        work=lambda _: plant.advance(voltage, LOOP_STEPS),
        prepare=lambda _: plant.reset(),
        about=0.02,
    )


def _one_core() -> dict[str, float]:
    """Ratio of two threads to one with both threads on one core, N = 24."""
    ratios = {}
    with tempfile.TemporaryDirectory() as folder, _on_one_core():
        scenes = {
            name: chain(Path(folder), 24, **{"integrator.scheme": "implicit", **kind})
            for name, kind in KINDS.items()
        }
        plants = {name: Plant(scene) for name, scene in scenes.items()}
        timings = interleaved({name: _task(plant) for name, plant in plants.items()}, 3)
        for name in TWO:
            ratios[name] = timings[name].median / timings["one"].median
    return ratios


@contextmanager
def _on_one_core() -> Iterator[None]:
    """Threads made in here share one core."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def _handshake() -> float:
    """Return the round trip of a counter between two threads [ns]."""
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "handshake"
        source = Path(__file__).with_name("handshake.cpp")
        command = [*find_compiler(), "-std=c++20", "-O2", "-pthread", str(source)]
        subprocess.run([*command, "-o", str(program)], check=True)
        ran = subprocess.run([str(program)], capture_output=True, text=True, check=True)
    return float(ran.stdout)


def report(figures: dict[str, Any]) -> str:
    """Return the section in Markdown."""
    trips = figures["handshake"]
    lines = [
        "`lag` is the exchange of the paper's Fig. 6, `predict` the one that leads "
        f"the sample on by its own speeds and accelerations, and at depth {DEPTH} by {DEPTH} steps "
        "(core/schemes/two_threads.hpp).",
        "",
        "Table 1 of the paper, on three_axis with scheme `paper`: difference between two threads "
        "and one after 1 s [rad], for waist, shoulder, elbow, and beside it the error of each "
        "against the reference.",
        "",
        "| step [s] | paper | "
        + " | ".join([f"{TITLES[k]} - one" for k in TWO] + [f"error, {TITLES[k]}" for k in KINDS])
        + " |",
        "|---|---" + "|---" * (len(TWO) + len(KINDS)) + "|",
    ]
    for step, row in figures["table_1"].items():
        cells = [
            PAPER[float(step)],
            *(row["difference"][kind] for kind in TWO),
            *(row["error"][kind] for kind in KINDS),
        ]
        lines.append(f"| {step} | " + " | ".join(map(_triple, cells)) + " |")
    lines += [
        "",
        f"A handshake (a counter to the other thread and back) took {min(trips):.0f} to "
        f"{max(trips):.0f} ns in this run. On a virtual machine it depends on which physical cores "
        "the two virtual ones are just then, and so do the ratios below.",
        "",
        "Time per step, two threads over one, on chains of N joints with scheme `implicit` (which "
        "holds the long ones too):",
        "",
        "| N | "
        + " | ".join([f"{TITLES[k]} [ns]" for k in KINDS] + [f"{TITLES[k]} / one" for k in TWO])
        + " |",
        "|---" * (1 + len(KINDS) + len(TWO)) + "|",
    ]
    pays = []
    for n, row in figures["loops"].items():
        ns = {kind: row[kind]["median"] * 1e9 for kind in KINDS}
        ratios = [ns[kind] / ns["one"] for kind in TWO]
        if min(ratios) < 1.0:
            pays.append(int(n))
        cells = [f"{ns[kind]:.0f}" for kind in KINDS] + [f"{ratio:.2f}" for ratio in ratios]
        lines.append(f"| {n} | " + " | ".join(cells) + " |")
    one_core = figures["one_core"]
    begin = f"from N = {min(pays)} on" if pays else "at none of these N"
    on_one_core = ", ".join(f"{one_core[kind]:.0f} ({TITLES[kind]})" for kind in TWO)
    lines += [
        "",
        f"Two threads paid {begin}; the paper had {PAPER_RATIO} at N = 3 on a machine whose single "
        "step took far longer than its handshake. Both threads on one core, N = 24: "
        f"{on_one_core} times one thread's time.",
    ]
    return "\n".join(lines)


def _triple(values: list[float]) -> str:
    return ", ".join(f"{value:.2e}" for value in values)
