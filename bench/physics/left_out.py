"""The demo of arms with effects that their scenes leave out: load friction, hysteresis of gears.

Servo and motion controller are the scene's: they do not know.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
import yaml

from arm_emulator import OfflineRun, Scene, load_gains, load_scene
from arm_emulator.base.io.config_files import find_config_folder, find_scene
from bench.measure import show_progress
from bench.physics.assumed import ARMS, make_demo, measure_outcome
from bench.tables import format_table

TITLE = "What the scenes of the arms leave out"

LARGE = {"ur5": 3, "panda": 4}  # joints
LOADS = 0.1, 0.2  # friction per torque of the gear
LOSSES, TWIST = (1.0, 2.0), 1e-3  # lost motion [arc minutes], twist beyond which all slips [rad]
JOINT = "erob80_100"


def list_effects(scene: Scene) -> dict[str, dict[str, Any]]:
    """Return what each effect changes in a scene."""
    file = find_config_folder() / "joints" / f"{JOINT}.yaml"
    published = yaml.safe_load(file.read_text())["joints"][JOINT]["motor"]["friction"]
    effects: dict[str, dict[str, Any]] = {"as the scene has it": {}}
    for load in LOADS:
        effects[f"load friction of {100 * load:g} % at the links, twice that at rest"] = {
            f"joints.{joint.name}.friction.{key}": load
            for joint in scene.joints
            for key in ("load", "rest_load")
        }
    for loss in LOSSES:
        half = 0.5 * np.radians(loss / 60.0)
        effects[f"gears with a lost motion of {loss:g}'"] = {
            f"joints.{joint.name}.gear.hysteresis": {
                "torque": float(half * (joint.gear.stiffness or 0.0)), "twist": TWIST,
            }
            for joint in scene.joints
        }  # fmt: skip
    effects[f"large joints with the friction of `{JOINT}`, at the rotors"] = {
        key: value
        for joint in scene.joints[: LARGE[scene.name]]
        for key, value in ((f"joints.{joint.name}.friction", None),
                           (f"joints.{joint.name}.motor.friction", published))
    }  # fmt: skip
    return effects


def run_bench(quick: bool) -> dict[str, Any]:
    """Make the demo with each effect."""
    return {name: _measure_effects(name, 30 if quick else None) for name in ARMS}


def _measure_effects(name: str, instructions: int | None) -> dict[str, dict[str, Any]]:
    file = find_scene(name)
    gains, effects = load_gains(file), list_effects(load_scene(file))
    demos = {}
    with show_progress(name, len(effects)) as done:
        for label, changes in effects.items():
            scene = load_scene(file, changes or None)
            demos[label] = make_demo(
                OfflineRun(scene, gains.servo, gains.motion), file, instructions
            )
            done(label)
    nominal = next(iter(demos.values()))
    return {label: asdict(measure_outcome(demo, nominal)) for label, demo in demos.items()}


def write_report(figures: dict[str, Any]) -> str:
    """Return the table."""
    rows = []
    for label in figures[ARMS[0]]:
        cells = []
        for name in ARMS:
            figures_of = figures[name][label]
            settled = "never" if figures_of["settled"] is None else figures_of["settled"]
            cells.append(f"{figures_of['residual']:.2f} / {figures_of['away']:.2f} / {settled}")
        rows.append((label, *cells))
    return format_table(("machine", *ARMS), rows)


if __name__ == "__main__":
    print(write_report(run_bench(False)))
