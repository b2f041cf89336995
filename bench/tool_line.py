"""Straightness of a tool's line: 300 mm at 250 mm/s, through the whole machine.

The servo sees motors, not links: what the gears give way under the arm's weight it cannot know. So
the true tool is beside the line by that wind-up, which follows from the gears' stiffness and the
torque of gravity at the link. What is left beside it is what servo and motion controller leave.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from arm_emulator import OfflineRun, Pose, load_gains, load_scene
from arm_emulator.base.config_files import find_scene
from arm_emulator.motion.link_torques import LinkTorques
from bench.measure import progress
from bench.motion import Array

TITLE = "A straight line with the tool"

SCENE = "ur5"
LENGTH = 0.3  # m, along y, half to each side of where the tool is at the start of the scene
PERIODS = (0.05, 0.01)  # s, motion periods
FEEDFORWARDS = ("none", "speed", "torque")
EVERY = 5  # servo periods between samples
_SETTLING = 3.0  # s, for the way to the start of the line


def run(quick: bool) -> dict[str, Any]:
    """Measure, for each motion period and feed-forward, how far the tool is from its line."""
    cases = [(period, given) for period in PERIODS for given in FEEDFORWARDS]
    chosen = cases[2:3] if quick else cases
    rows = []
    with progress("lines", len(chosen)) as done:
        for period, given in chosen:
            rows.append(line(period, given))
            done(f"{given}, {period:g} s")
    return {"rows": rows}


def line(period: float, feedforward: str) -> dict[str, Any]:
    """Return the figures of one line."""
    file = find_scene(SCENE)
    scene, gains = load_scene(file), load_gains(file)
    motion = dataclasses.replace(gains.motion, period=period, method="way", feedforward=feedforward)
    servo = dataclasses.replace(gains.servo, motion_period=period)
    one = OfflineRun(scene, servo, motion)
    kinematics = one.controller.kinematics
    R_WT, p_WT = kinematics.forward(scene.start)
    along = np.array([0.0, 1.0, 0.0])
    begin, end = (Pose(p_WT + side * 0.5 * LENGTH * along, R_WT) for side in (-1.0, 1.0))
    one.instructor.add_path(one.controller, [begin])
    one.advance(round(_SETTLING / scene.servo_period))
    one.instructor.add_path(one.controller, [begin, end])
    gravity = LinkTorques(scene.urdf, kinematics.joint_names, scene.gravity or (0.0, 0.0, 0.0))
    off: list[Array] = []
    predicted: list[Array] = []
    motors: list[Array] = []
    times: list[float] = []
    places: list[float] = []
    still = np.zeros(len(scene.start))
    while not times or one.instructor.reports.waiting[-1].state.name == "MOVING" or len(times) < 10:
        one.advance(EVERY)
        q, q_motor = one.session.state.q, one.drives.servo.q_measured[one._to_motion]  # noqa: SLF001
        torques = gravity.at(q_motor, still)
        tool, of_motors, wound = (
            kinematics.forward(angles)[1] - begin.p_WT
            for angles in (q, q_motor, q_motor - scene.wind_up(torques))
        )
        off.append(tool - along * (along @ tool))
        motors.append(of_motors - along * (along @ of_motors))
        predicted.append(wound - of_motors)
        times.append(one.session.logical_ns * 1e-9)
        places.append(float(along @ tool))
    across = np.eye(3) - np.outer(along, along)
    aside = np.array(predicted) @ across
    return {
        "period": period,
        "feedforward": feedforward,
        "off": _largest(np.array(off)),
        "predicted": _largest(aside),
        "left": _largest(np.array(off) - aside),
        "motors": _largest(np.array(motors)),
        "fastest": float(np.max(np.gradient(places, times))),
        "end": LENGTH - places[-1],
    }


def _largest(vectors: Array) -> float:
    """Return the largest length of vectors (K, 3)."""
    return float(np.linalg.norm(vectors, axis=1).max())


def report(figures: dict[str, Any]) -> str:
    """Return the section of the report."""
    lines = [
        f"{LENGTH * 1e3:g} mm along y at 250 mm/s with `{SCENE}`, orientation held; the largest "
        "distance of the true tool from the line, the part of it that the gears' wind-up under the "
        "links' weight predicts, and what is left beside that.",
        "",
        "| motion period | feed-forward | off the line | predicted | left | motors off | fastest |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in figures["rows"]:
        millimetres = (f"{row[key] * 1e3:.3f} mm" for key in ("off", "predicted", "left", "motors"))
        lines.append(
            f"| {row['period'] * 1e3:g} ms | {row['feedforward']} | {' | '.join(millimetres)} | "
            f"{row['fastest'] * 1e3:.0f} mm/s |"
        )
    return "\n".join(lines)
