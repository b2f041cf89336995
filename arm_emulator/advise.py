"""`arm_emulator advise`: the cheapest scheme and step for a wanted error, on the scene's motion."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from arm_emulator.demo_plan import NANOSECONDS, DemoPlan
from arm_emulator.gains import load_gains
from arm_emulator.offline import OfflineRun
from emulator_node.advice import Motion, Setting, advise, write_integrator
from emulator_node.plant import Diverged
from emulator_node.reference import reference
from emulator_node.scene import Scene, load_scene
from motion_controller_node.pose import Pose
from words.config_files import find_scene
from words.refusal import Refusal
from words.yaml_file import read_yaml

Array = NDArray[np.float64]

SECONDS = 1.0  # of the motion, after the arm has settled
FINE = 20  # steps per servo period while the motion is recorded


def advise_scene(scene_name: str, error: float, write: bool) -> int:
    """Find, show and, if asked, write the cheapest setting.

    Args:
        scene_name: scene file or name.
        error: largest error of a link that is wanted [rad or m].
        write: whether to put the setting into the scene file.

    Returns:
        Exit code: 1 if no setting reaches the error.
    """
    console = Console(highlight=False)
    file = find_scene(scene_name)
    scene = load_scene(file)
    voltages, what = record(scene, file)
    motion = Motion(scene, voltages)
    with console.status(f"trying schemes and steps on {what}"):
        settings = advise(motion, error)
        truth, why = _truth(scene, file, voltages, error)
        now = motion.setting(scene.integrator.scheme, scene.steps_per_period)
        table = _table(motion, settings, now, truth)
    console.print(f"scene {scene.name}, {what}; wanted: error <= {error:g} rad or m on the way")
    console.print(table)
    console.print(why)
    if not settings:
        console.print(f"no scheme reaches {error:g} with a step that can be tried")
        return 1
    best = settings[0]
    console.print(f"cheapest: integrator: {{scheme: {best.scheme}, dt: {best.dt:.6g}}}")
    if write:
        write_integrator(file, best.scheme, best.dt)
        console.print(f"written into {file}")
    return 0


def record(scene: Scene, file: Path) -> tuple[Array, str]:
    """Return voltages (K, N) [V] of the scene's own motion, a row per servo period, and its name.

    With gains and a demo beside the scene: its demo, in closed loop, recorded
    once on the finely integrated machine. Played back open loop, errors are those of the
    integration, and not what the control made of them. Else sines of a quarter of the supply.
    """
    fine = dataclasses.replace(
        scene,
        integrator=dataclasses.replace(
            scene.integrator, scheme="rosenbrock", dt=scene.servo_period / FINE
        ),
        threads=1,
    )
    rows: list[Array] = []
    try:
        gains = load_gains(file)
        plan = DemoPlan.load(file, round(gains.motion.period * NANOSECONDS))
        run = OfflineRun(fine, gains.servo, gains.motion)
    except Refusal:
        return _sines(scene), "sines of a quarter of the supply voltage for 1 s (it has no demo)"
    R_WT, p_WT = run.controller.kinematics.forward(scene.start)
    settle = plan.settle_ns / NANOSECONDS
    run.instructor.add(plan.settle_ns, Pose(p_WT + plan.displacement, R_WT))
    try:
        for _ in range(round((settle + SECONDS) / scene.servo_period)):
            run.advance(1)
            rows.append(run.session.voltage)
    except Diverged:
        return _sines(scene), "sines of a quarter of the supply voltage for 1 s (its demo diverges)"
    return np.array(rows), f"{settle + SECONDS:g} s of its demo"


def _sines(scene: Scene) -> Array:
    j = np.arange(len(scene.joints))
    t = scene.servo_period * np.arange(math.ceil(SECONDS / scene.servo_period))[:, None]
    out: Array = 0.25 * scene.supply_voltage * np.sin(2.0 * np.pi * (0.5 + 0.1 * j) * t + j)
    return out


def _truth(scene: Scene, file: Path, voltages: Array, error: float) -> tuple[Array | None, str]:
    """Return the motion by the independent reference, (K, N), or None and why there is none."""
    payload: Any = read_yaml(file).get("payload")
    # Per step of the reference, of which there are some thousand: far below the error it judges.
    rtol = max(1e-4 * error, 1e-11)
    try:
        truth = reference(scene, voltages, scene.servo_period, rtol, payload=payload)
    except Refusal as reason:
        return None, f"no reference for this scene: {reason}"
    told = "on Pinocchio's dynamics (emulator_node/reference.py)"
    return truth, f"reference: SciPy at {rtol:.0e} {told}"


def _table(motion: Motion, settings: list[Setting], now: Setting, truth: Array | None) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("")
    table.add_column("scheme")
    for name in ("dt [s]", "estimate", "reference says", "us per second"):
        table.add_column(name, justify="right")
    labels = ["cheapest", *[""] * (len(settings) - 1)] if settings else []
    for label, one in [*zip(labels, settings, strict=True), ("now", now)]:
        steps = round(motion.scene.servo_period / one.dt)
        q = motion.q(one.scheme, steps)
        off = "-" if truth is None or q is None else f"{np.abs(q - truth).max():.2e}"
        estimate = f"{one.estimate:.2e}" if math.isfinite(one.estimate) else "diverges"
        cost = f"{one.cost * 1e6:.0f}" if math.isfinite(one.cost) else "-"
        table.add_row(label, one.scheme, f"{one.dt:.6g}", estimate, off, cost)
    return table
