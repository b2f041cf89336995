"""Resonances of an arm whose main bearings tilt.

python -m bench.bearing_modes
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator import Scene, linearise, load_scene
from arm_emulator_analysis.commands.bode import compute_frequency_response
from bench.measure import show_progress
from bench.tables import format_table

TITLE = "Bearings that tilt"

SCENE = Path(__file__).resolve().parents[3] / "config" / "validation" / "kr560" / "kr560.yaml"
TILTING = ("joint_1", "joint_2", "joint_3")
DIRECTIONS = "tilt_x", "tilt_y"  # across the axes of the joints, which are all z
STIFFNESS = (None, 10.0, 3.0, 1.0)  # times that of the joint's gear; None: rigid
FREQUENCIES = np.geomspace(1.0, 100.0, 4001)  # Hz


def run_bench(quick: bool) -> dict[str, Any]:
    """Find the antiresonances of the tilting joints for each stiffness."""
    rows = []
    chosen = STIFFNESS[: 2 if quick else None]
    with show_progress("scenes", len(chosen)) as done:
        for factor in chosen:
            scene = load_tilting(factor)
            linear = linearise(scene, scene.start)
            names = list(scene.joint_names)
            modes = {
                name: compute_frequency_response(
                    linear, names.index(name), FREQUENCIES
                ).antiresonances
                for name in TILTING
            }
            rows.append(
                {
                    "factor": factor,
                    **{name: frequency.tolist() for name, frequency in modes.items()},
                }
            )
            done(str(factor))
    return {"rows": rows}


def load_tilting(factor: float | None) -> Scene:
    """Load the scene with bearings of a stiffness and a damping, as multiples of the gears'."""
    if factor is None:
        return load_scene(SCENE)
    gears = {joint.name: joint.gear for joint in load_scene(SCENE).joints}
    bearings = {
        f"joints.{name}.bearing.{direction}.{key}": factor * getattr(gears[name], key)
        for name in TILTING
        for direction in DIRECTIONS
        for key in ("stiffness", "damping")
    }
    return load_scene(SCENE, bearings)


def write_report(figures: dict[str, Any]) -> str:
    """Return the table."""
    rows = []
    for row in figures["rows"]:
        factor = row["factor"]
        cells = (
            ", ".join(f"{frequency:.1f}" for frequency in row[name]) + " Hz" for name in TILTING
        )
        rows.append(("rigid" if factor is None else f"{factor:g} times the gear", *cells))
    return format_table(("bearings of `kr560`", *(f"`{name}`" for name in TILTING)), rows)


if __name__ == "__main__":
    print(write_report(run_bench(False)))
