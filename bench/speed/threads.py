"""Two threads against one: from how many joints on the second core pays."""

from __future__ import annotations

import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator import Plant
from bench.measure import Task, compile_all, measure_interleaved, show_progress
from bench.speed.chains import write_chain
from bench.tables import format_table

TITLE = "Two threads"

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


def run_bench(quick: bool) -> dict[str, Any]:
    """Time one step of each kind, interleaved."""
    joints, repetitions = ((3, 24), 7) if quick else (JOINTS, 21)
    loops: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        scenes = {
            n: {
                name: write_chain(Path(folder), n, **{"integrator.scheme": "implicit", **kind})
                for name, kind in KINDS.items()
            }
            for n in joints
        }
        compile_all(scene for kinds in scenes.values() for scene in kinds.values())
        with show_progress("time per loop", len(joints)) as done:
            for n, kinds in scenes.items():
                tasks = {name: _make_task(Plant(scene)) for name, scene in kinds.items()}
                timings = measure_interleaved(tasks, repetitions)
                loops[str(n)] = {
                    name: asdict(timing.divide_by(LOOP_STEPS)) for name, timing in timings.items()
                }
                done(f"N = {n}")
    return {"loops": loops}


def _make_task(plant: Plant) -> Task:
    voltage = 3.0 * (-1.0) ** np.arange(len(plant.scene.joints))
    return Task(
        work=lambda _: plant.advance(voltage, LOOP_STEPS),
        prepare=lambda _: plant.reset(),
        about=0.02,
    )


def write_report(figures: dict[str, Any]) -> str:
    """Return the section in Markdown."""
    lines = [
        "`lag` is the exchange of the paper's Fig. 6, `predict` the one that leads "
        f"the sample on by its own speeds and accelerations, and at depth {DEPTH} by {DEPTH} steps "
        "(core/schemes/two_threads.hpp); `test/schemes/test_threads.py` holds the paper's Table 1. "
        "Time per step, two threads over one, on chains of N joints with scheme `implicit` (which "
        "holds the long ones too). On a virtual machine the ratios depend on which physical cores "
        "the two virtual ones are just then.",
        "",
    ]
    pays, rows = [], []
    for n, row in figures["loops"].items():
        ns = {kind: row[kind]["median"] * 1e9 for kind in KINDS}
        ratios = [ns[kind] / ns["one"] for kind in TWO]
        if min(ratios) < 1.0:
            pays.append(int(n))
        rows.append((n, *(f"{ns[k]:.0f}" for k in KINDS), *(f"{ratio:.2f}" for ratio in ratios)))
    heads = "N", *(f"{TITLES[k]} [ns]" for k in KINDS), *(f"{TITLES[k]} / one" for k in TWO)
    begin = f"from N = {min(pays)} on" if pays else "at none of these N"
    lines += [
        format_table(heads, rows),
        "",
        f"Two threads paid {begin}; the paper had {PAPER_RATIO} at N = 3 on a machine whose single "
        "step took far longer than its handshake.",
    ]
    return "\n".join(lines)
