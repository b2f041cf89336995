"""Error against step of a machine in MuJoCo Warp, in single precision, beside ours in double."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator import Plant
from arm_emulator.base.arrays import Array
from bench.fleet import make_bare_scene
from bench.measure import show_progress
from bench.pictures import COLOURS, make_figure, save_picture
from bench.reference_motions import SERVO_PERIOD, make_sines
from bench.speed.mujoco_peer import MujocoArm, end_of
from bench.tables import format_table
from oracles.reference import solve_positions

TITLE = "Errors beside MuJoCo Warp"

ARMS = ("three_axis", "ur5")
INTEGRATORS = ("implicitfast", "RK4")  # of MuJoCo Warp
STEPS = (1, 2, 5)  # in a period of 1 ms: on a processor it takes minutes for more
OURS = "rosenbrock"


def run_bench(quick: bool) -> dict[str, Any]:
    """Measure the error of each arm after a second."""
    arms, steps = (ARMS[:1], STEPS[:1]) if quick else (ARMS, STEPS)
    figures: dict[str, Any] = {"steps": list(steps), "arms": {}}
    with show_progress("MuJoCo Warp", len(arms) * len(steps) * len(INTEGRATORS)) as done:
        for name in arms:
            scene = make_bare_scene(name, OURS, SERVO_PERIOD)
            rows = make_sines(len(scene.joints), 0)
            truth = solve_positions(scene, rows, SERVO_PERIOD)[-1]
            errors: dict[str, list[float | None]] = {}
            for count in steps:
                dt = SERVO_PERIOD / count
                own = Plant(make_bare_scene(name, OURS, dt))
                ends = {f"{OURS}, double": end_of(own, rows, count)}
                for integrator in INTEGRATORS:
                    peer = MujocoArm(scene, integrator, dt)
                    ends[f"MuJoCo {integrator}, double"] = end_of(peer, rows, count)
                    ends[f"MuJoCo Warp {integrator}, single"] = _end_in_warp(peer, rows, count)
                    done(name)
                for series, end in ends.items():
                    error = None if end is None else float(np.abs(end - truth).max())
                    errors.setdefault(series, []).append(error)
            figures["arms"][name] = errors
    return figures


def _end_in_warp(arm: MujocoArm, rows: Array, steps: int) -> Array | None:
    """Return link positions (N,) after each row was held for `steps` steps; None: it diverged."""
    warp = importlib.import_module("warp")
    warp.config.quiet = True
    mjw = importlib.import_module("mujoco_warp")
    arm.reset()
    with warp.ScopedDevice("cpu"):
        model, data = mjw.put_model(arm.model), mjw.put_data(arm.model, arm.data, nworld=1)
        for row in rows:
            data.ctrl.assign(arm.choose_driven(row)[np.newaxis].astype(np.float32))
            for _ in range(steps):
                mjw.step(model, data)
        q = arm.choose_links(data.qpos.numpy()[0])
    return q if np.isfinite(q).all() else None


def draw_figures(figures: dict[str, Any], folder: Path) -> None:
    """Draw error against step."""
    figure = make_figure(4.6 * len(figures["arms"]), 4.4)
    panels = figure.subplots(1, len(figures["arms"]), squeeze=False)[0]
    steps = [1e3 * SERVO_PERIOD / count for count in figures["steps"]]
    for axes, (name, errors) in zip(panels, figures["arms"].items(), strict=True):
        for series, values in errors.items():
            ours = series.startswith(OURS)
            style = {"color": COLOURS[OURS], "linewidth": 2.0} if ours else {"linewidth": 1.0}
            line = ":" if "double" in series and not ours else "-"
            axes.loglog(steps, values, label=series, marker="o", linestyle=line, **style)
        axes.set_title(name)
        axes.set_xlabel("step [ms]")
        axes.grid(True, color="0.9", linewidth=0.8)
    panels[0].set_ylabel("error after 1 s [rad]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    save_picture(figure, folder, "warp_error")


def write_report(figures: dict[str, Any]) -> str:
    """Return the section in Markdown."""
    heads = [f"{SERVO_PERIOD / count * 1e3:g} ms" for count in figures["steps"]]
    rows = [
        (name, series, *("diverged" if error is None else f"{error:.1e}" for error in errors))
        for name, of_arm in figures["arms"].items()
        for series, errors in of_arm.items()
    ]
    return f"""\
Largest error of a link after a second of sines, from rest, in rad, against the reference of the
section on work and precision. Both machines are the same: motors, elastic gears and links without
what MuJoCo lacks. MuJoCo Warp computes in single precision; here it runs on the processor, where
its kernels give the same numbers as on a card up to rounding. Its time means nothing for a card
and is left out.

{format_table(("arm", "series", *heads), rows)}

![error against step](warp_error.png)"""
