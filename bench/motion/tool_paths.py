"""Tool paths through the whole machine: how far the true tool is beside them.

Lines, circles and corners with blend, at two speeds. Nothing is taken off: the feed-forward `full`
knows the wind-up of the gears, so that the links are where they shall be.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator import OfflineRun, Pose, load_gains, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.motion.executor.path_monitor import measure_distances
from bench.measure import show_progress
from bench.pictures import make_figure
from bench.tables import format_table

TITLE = "Tool paths all the way"

SCENES = ("ur5", "panda")
SPEEDS = (0.25, 1.0)  # m/s
KINDS = ("line", "circle", "corners")
ACCELERATION, JERK = 5.0, 100.0  # m/s2, m/s3
EVERY = 2  # servo periods between samples
LONGEST = 20.0  # s


@dataclass
class PathRun:
    """One path through the machine: samples of the true tool and of the joints."""

    t: Array
    tool: Array
    off: Array
    """Beside the path (K,) [m]."""
    joints: Array
    """Link speeds over their limits (K, N)."""
    end: str
    reason: str


def list_poses(kind: str, home: Pose) -> list[Array]:
    """Return the points of a path about the tool's start."""
    if kind == "line":
        points = [(0.0, -0.15, 0.0), (0.0, 0.15, 0.0)]
    elif kind == "circle":
        points = [
            (0.1 * math.cos(turn) - 0.1, 0.1 * math.sin(turn), 0.0)
            for turn in np.linspace(0.0, 2.0 * math.pi, 5)
        ]
    else:
        points = [(0.0, -0.1, 0.0), (0.0, 0.1, 0.0), (0.0, 0.1, 0.15), (0.0, -0.1, 0.15)]
    return [home.p_WT + np.array(point) for point in points]


def drive_tool(
    scene_name: str, kind: str, speed: float, comes_from: tuple[float, ...] | None = None
) -> PathRun:
    """Send the tool along a path, to whose first pose it comes from beside it [m] or rests."""
    file = find_scene(scene_name)
    scene, gains = load_scene(file), load_gains(file)
    motion = dataclasses.replace(
        gains.motion,
        tool_speed=speed,
        tool_acceleration=ACCELERATION,
        tool_jerk=JERK,
        path_arcs=kind == "circle",
        path_blend=0.03 * (kind == "corners"),
        tool_path_tolerance=0.0,
    )
    offline_run = OfflineRun(scene, gains.servo, motion)
    kinematics, session = offline_run.controller.kinematics, offline_run.session
    R_WT, p_WT = kinematics.forward(scene.start)
    path = [Pose(p, R_WT) for p in list_poses(kind, Pose(p_WT, R_WT))]
    settle = round(2.0 / scene.servo_period)
    if comes_from is not None:
        offline_run.instructor.add(0, Pose(path[0].p_WT + np.array(comes_from), R_WT))
        offline_run.advance(settle)
    offline_run.instructor.add_path(offline_run.controller, path[:1])
    offline_run.advance(settle)
    offline_run.instructor.reports.take_reports()
    offline_run.instructor.add_path(offline_run.controller, path)
    t, tool, joints, targets = [], [], [], []
    end, reason, after = "", "", 0
    while session.logical_ns * 1e-9 < LONGEST and after < 100:
        offline_run.advance(EVERY)
        q = session.state.q
        t.append(session.logical_ns * 1e-9)
        tool.append(kinematics.forward(q)[1])
        joints.append(np.abs(session.state.v) / kinematics.velocity_limit)
        targets.append(kinematics.forward(offline_run.instructor.leading.coming.q)[1])  # type: ignore[union-attr]
        for report in offline_run.instructor.reports.take_reports():
            end, reason = report.state.name, report.reason or reason
        after += end in ("REACHED", "REFUSED", "ABORTED", "UNREACHABLE")
    line = np.array(targets)
    off = np.array([measure_distances(p[None], line[:-1], line[1:]).min() for p in np.array(tool)])
    return PathRun(np.array(t) - t[0], np.array(tool), off, np.array(joints), end, reason)


def run_bench(quick: bool) -> dict[str, Any]:
    """Measure all paths."""
    cases = [(s, k, v) for s in SCENES for k in KINDS for v in SPEEDS]
    rows = []
    with show_progress("paths", len(cases[:: 4 if quick else 1])) as done:
        for scene, kind, speed in cases[:: 4 if quick else 1]:
            followed = drive_tool(scene, kind, speed)
            rows.append(
                {
                    "scene": scene,
                    "kind": kind,
                    "speed": speed,
                    "end": followed.end,
                    "reason": followed.reason,
                    "off": float(followed.off.max()),
                    "joints": float(followed.joints.max()),
                    "seconds": float(followed.t[-1]),
                }
            )
            done(f"{scene}, {kind}, {speed:g} m/s")
    return {"rows": rows}


def write_report(figures: dict[str, Any]) -> str:
    """Return the section of the report."""
    lines = [
        "300 mm, circles of 100 mm radius and corners rounded from 30 mm before, with "
        f"{ACCELERATION:g} m/s² and {JERK:g} m/s³. The true tool's largest distance from the way "
        "asked for, and the largest link speed over its limit.",
        "",
    ]
    rows = (
        (row["scene"], row["kind"], f"{row['speed']:g} m/s", row["end"].lower(),
         f"{row['off'] * 1e3:.2f} mm", f"{row['joints']:.2f}")
        for row in figures["rows"]
    )  # fmt: skip
    heads = ("scene", "path", "asked", "ends", "beside it", "speed / limit")
    return "\n".join([*lines, format_table(heads, rows)])


def draw_picture(folder: Path) -> Path:
    """Draw one path of each kind: where the tool goes, speeds over limits, distance from it."""
    figure = make_figure(9.0, 7.0)
    axes = figure.subplots(3, len(KINDS))
    for column, kind in enumerate(KINDS):
        followed = drive_tool("ur5", kind, SPEEDS[-1])
        path_axes, speeds, off = axes[:, column]
        side = 2 if kind == "corners" else 0
        path_axes.plot(followed.tool[:, 1], followed.tool[:, side], lw=1.0)
        path_axes.set_title(f"{kind}, {SPEEDS[-1]:g} m/s")
        path_axes.set_xlabel("y [m]")
        path_axes.set_ylabel("z [m]" if side else "x [m]")
        path_axes.axis("equal")
        speeds.plot(followed.t, followed.joints, lw=0.8)
        speeds.axhline(1.0, color="k", lw=0.8)
        speeds.set_ylabel("link speed / limit")
        off.plot(followed.t, followed.off * 1e3, lw=0.8)
        off.set_ylabel("beside the path [mm]")
        off.set_xlabel("t [s]")
    joints = [f"joint {k}" for k in range(1, followed.joints.shape[1] + 1)]
    axes[1, -1].legend(joints, fontsize=6, ncols=2, loc="upper right", bbox_to_anchor=(1.0, 0.97))
    file = folder / "tool_paths.png"
    figure.savefig(file, dpi=110)
    return file
