"""Time of the first use of a scene, and of later ones: fresh processes, no ROS."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict
from typing import Any

from bench.measure import WallTime, make_wall_time, show_progress
from bench.tables import format_table

TITLE = "First use"

SCENES = ("three_axis", "ur5", "panda")
PARTS = ("ready", "import", "scene", "plant", "process")

# numpy is imported beforehand: nearly every program that would use a plant has it.
PROGRAM = """
import json, sys, time
import numpy
started = time.perf_counter()
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.scene.scene import load_scene
imported = time.perf_counter()
scene = load_scene(sys.argv[1])
loaded = time.perf_counter()
plant = Plant(scene)
plant.advance(numpy.zeros(len(scene.joints)), 1)
ready = time.perf_counter()
ros = sorted(name for name in sys.modules if name.startswith(("rclpy", "ament", "rosidl")))
print(json.dumps({"import": imported - started, "scene": loaded - imported,
                  "plant": ready - loaded, "ready": ready - started, "ros": ros}))
"""


def run_bench(quick: bool) -> dict[str, Any]:
    """Measure with an empty cache, then with a filled one."""
    repetitions = 5 if quick else 15
    figures: dict[str, Any] = {}
    with (
        tempfile.TemporaryDirectory() as cache,
        show_progress("first use", len(SCENES) * (1 + repetitions)) as done,
    ):
        for name in SCENES:
            first, _ = _run_process(name, cache)
            done(f"{name}, compiled")
            figures[name] = {"first": first, "runs": []}
        for _ in range(repetitions):
            for name in SCENES:
                inside, in_process = _run_process(name, cache)
                figures[name]["runs"].append({**inside, "process": in_process})
                done(f"{name}, cached")
    for figure in figures.values():
        runs = figure.pop("runs")
        for part in PARTS:
            figure[part] = asdict(make_wall_time(run[part] for run in runs))
        figure["ros"] = runs[0]["ros"]
    return figures


def _run_process(scene: str, cache: str) -> tuple[dict[str, Any], float]:
    """Return what a fresh process reports, and how long the whole of it took [s]."""
    environment = {**os.environ, "ARM_EMULATOR_CACHE": cache, "PYTHONPYCACHEPREFIX": cache}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # bytecode is kept, as it usually is
    command = [sys.executable, "-c", PROGRAM, scene]
    started = time.perf_counter()
    run = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    return json.loads(run.stdout), time.perf_counter() - started


def write_report(figures: dict[str, Any]) -> str:
    """Return the section in Markdown."""
    lines = [
        "A fresh Python process that has imported numpy makes a scene's plant and takes a step. "
        "First with an empty cache, so that the core is compiled; then with the library in the "
        "cache (medians, half the distance of the quartiles). The process as a whole includes "
        "Python's own start and that of numpy, and its end. Python keeps its bytecode, as usual.",
        "",
    ]
    rows = []
    for name, figure in figures.items():
        times = [WallTime(**figure[part]) for part in PARTS]
        cells = (f"{one.median * 1e3:.1f} ms ± {100 * one.spread:.0f} %" for one in times)
        ros = ", ".join(figure["ros"]) or "none"
        rows.append((name, f"{figure['first']['ready']:.2f} s", *cells, ros))
    heads = ("scene", "first use: compiled, ready after", "cached: ready after", "of it imports",
             "scene file and URDF", "library and first step", "whole process",
             "ROS modules imported")  # fmt: skip
    return "\n".join([*lines, format_table(heads, rows)])
