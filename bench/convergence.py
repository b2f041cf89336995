"""Convergence of eq. (6): predicted from one step of the servo, measured on the machine."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator import OfflineRun, Pose, Session, load_gains, load_scene
from arm_emulator.base.config_files import find_scene
from arm_emulator.servo.drives import Drives, Target
from bench.measure import progress
from bench.motion import Array
from oracles.convergence import convergence_factor, expected_errors

TITLE = "Convergence of eq. (6)"

SCENE = "three_axis"  # at its start the waist alone moves the tool along y
PERIODS = (0.02, 0.05, 0.2)  # s, motion periods
WEIGHTS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
WAY = 0.02  # m; a count of the encoder is 1e-3 of it
_LONG = 1.0  # s until the servo is there
INSTRUCTIONS = 40


def step_response(period: float) -> Array:
    """Return which part of a step of the waist's target the servo has gone, by motion periods."""
    file = find_scene(SCENE)
    scene, config = load_scene(file), load_gains(file).servo
    session, drives = Session(scene, "lockstep", "first_answer"), Drives(config)
    target = scene.start.copy()
    target[0] += WAY / 0.43
    gone = []
    for tick in range(round(_LONG / scene.servo_period) + 1):
        measured = session.measured
        drives.measure(session.logical_ns, measured.encoder_counts, measured.current)
        drives.aim(Target(target))
        if tick and tick % round(period / scene.servo_period) == 0:
            measured = drives.servo.q_measured[0]
            gone.append((measured - scene.start[0]) / (target[0] - scene.start[0]))
        session.offer(tick, list(config.joint_names), drives.command(True).tolist())
        session.advance()
    return np.array(gone)


def measured_factor(weight: float, period: float) -> float:
    """Return the factor by which the machine's error falls per instruction."""
    file = find_scene(SCENE)
    gains = load_gains(file)
    motion = dataclasses.replace(
        gains.motion, method="paper", weight=weight, period=period, step_limit=10.0
    )
    servo = dataclasses.replace(gains.servo, motion_period=period)
    one = OfflineRun(load_scene(file), servo, motion)
    kinematics, session = one.controller.kinematics, one.session
    R_WT, p_WT = kinematics.forward(session.scene.start)
    target = Pose(p_WT + np.array([0.0, WAY, 0.0]), R_WT)
    one.instructor.add(0, target)
    errors = []
    for _ in range(INSTRUCTIONS):
        one.advance(one.motion_ticks)
        errors.append(kinematics.tool_error(one.drives.servo.q_measured, target)[1] / WAY)
    return convergence_factor(errors)


def run(quick: bool) -> dict[str, Any]:
    """Predict and measure for each motion period and weight."""
    weights = WEIGHTS[::4] if quick else WEIGHTS
    rows = []
    with progress("convergence", len(PERIODS) * len(weights)) as done:
        for period in PERIODS:
            response = step_response(period)
            for weight in weights:
                rows.append(
                    {
                        "period": period,
                        "weight": weight,
                        "first": float(response[0]),
                        "predicted": convergence_factor(
                            expected_errors(weight, response, INSTRUCTIONS)
                        ),
                        "measured": measured_factor(weight, period),
                    }
                )
                done(f"w = {weight:g}, {period:g} s")
    return {"rows": rows}


def draw(figures: dict[str, Any], folder: Path) -> None:
    """Draw the factors over the weight into `convergence.png`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.subplots()
    w = np.linspace(0.0, 1.0, 2)
    axes.plot(w, 1.0 - w, color="0.6", linestyle=":", label="1 - w: a servo that is always there")
    for period, colour in zip(PERIODS, ("#2a6fb0", "#d9731a", "#3c8f4f"), strict=True):
        rows = [row for row in figures["rows"] if row["period"] == period]
        weights = [row["weight"] for row in rows]
        part = f"{rows[0]['first'] * 100:.0f} % of a step in a period"
        label = f"{period * 1e3:g} ms, {part}"
        axes.plot(weights, [row["predicted"] for row in rows], color=colour, label=label)
        axes.plot(weights, [row["measured"] for row in rows], "o", color=colour, markersize=4)
    axes.set_xlabel("w")
    axes.set_ylabel("error after an instruction over that before")
    axes.set_title("Convergence of eq. (6): predicted (lines), measured (dots)")
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.0)
    axes.legend(frameon=False)
    axes.grid(True, color="0.9")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(folder / "convergence.png", dpi=110)


def report(figures: dict[str, Any]) -> str:
    """Return the section of the report."""
    lines = [
        "Error of the tool after an instruction over that before, in the mean down to 2 % of the "
        "way; `three_axis`, 20 mm along y: predicted from one step of the servo "
        "([motion.md](../motion.md)), and measured.",
        "",
        "| motion period | servo's part in it | w | predicted | measured |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {row['period'] * 1e3:g} ms | {row['first']:.3f} | {row['weight']:g} | "
        f"{row['predicted']:.3f} | {row['measured']:.3f} |"
        for row in figures["rows"]
    ]
    return "\n".join([*lines, "", "![](convergence.png)"])
