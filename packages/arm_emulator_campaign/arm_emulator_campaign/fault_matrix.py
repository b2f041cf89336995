"""The fault matrix of a scene: each fault by itself in the middle of a move, and who detects it."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import Refusal, find_scene
from arm_emulator.extension.machine import Diverged, Scene, SceneFault, load_scene
from arm_emulator.extension.runs import MotionState, OfflineRun, Pose, load_gains

AWAY = (0.0, 0.05, 0.05)  # m, of the tool and back
BEGINS, ENDS = 0.1, 1.5  # s, of the fault and of the run
UNDETECTED = "nobody"
COLOURS = {
    "drive": "#4878a8", "servo": "#6aa56e", "motion controller": "#d99a3d",
    "encoder check": "#8a6fb0", UNDETECTED: "#d1495b",
}  # fmt: skip


@dataclass(frozen=True)
class FaultRow:
    """Outcome of one fault at the magnitude that shows it well.

    Attributes:
        detected_by: one of `COLOURS`.
        after: until then [s]; NaN: not within the run.
        travel: largest distance of the tool from that of the sound run meanwhile [m].
    """

    fault: str
    kind: str
    magnitude: float
    unit: str
    detected_by: str
    after: float
    travel: float


@dataclass(frozen=True)
class _Trace:
    tool: list[NDArray[np.float64]]
    by: str
    at: int  # motion periods
    apart: float  # of the encoders of a joint, at most [rad or m]


def try_faults(scene_name: str) -> list[FaultRow]:
    """Return a row per fault that the scene can have.

    Raises:
        Refusal: a scene that is not taken, or gains that do not fit.
    """
    file = find_scene(scene_name)
    scene, gains = _load_with_faults(str(file)), load_gains(file)
    run = OfflineRun(scene, gains.servo, gains.motion)
    fresh = run.session.plant.save()
    sound = _simulate_fault(run, fresh, None, math.inf)
    return [
        _make_row(run, fault, sound, _simulate_fault(run, fresh, fault, 4.0 * sound.apart))
        for fault in scene.faults
    ]


def _load_with_faults(file: str) -> Scene:
    """Return the scene with all faults that it can have together."""
    names = [fault.name for fault in load_scene(file, {"faults": []}).possible_faults]
    try:
        return load_scene(file, {"faults": names})
    except Refusal:  # the payload and a number of the link that carries it
        return load_scene(file, {"faults": [n for n in names if not n.endswith("mass_at_joint")]})


def _simulate_fault(
    run: OfflineRun, fresh: bytes, fault: SceneFault | None, apart: float
) -> _Trace:
    """Move away and back, with the fault from `BEGINS` on."""
    run.restart(fresh)
    session, period = run.session, run.session.scene.servo_period
    R_WT, p_WT = run.controller.kinematics.forward(session.scene.start)
    path = [Pose(p_WT + np.array(AWAY), R_WT), Pose(p_WT, R_WT)]
    run.instructor.add_path(run.controller, path, 0)
    tool: list[NDArray[np.float64]] = []
    by, at, largest = UNDETECTED, 0, 0.0
    begins = math.ceil(BEGINS / period / run.motion_ticks)
    for k in range(math.ceil(ENDS / period / run.motion_ticks)):
        if k == begins and fault is not None:
            session.set_varied(fault.varied.name, fault.varied.number.default)
        able = run.drives.movable(session.powered).all()
        try:
            run.advance(run.motion_ticks)
        except Diverged:
            return _Trace(tool, "drive", k + 1 - begins, largest)
        tool.append(run.true_tool[1])
        largest = max(largest, _compare_encoders(run))
        unable = k > begins and able and not run.drives.movable(session.powered).all()
        states = [message.state for message in run.instructor.reports.waiting]
        run.instructor.reports.waiting.clear()
        messages = [
            *["drive"] * bool(session.measured.faults.any()),
            *["servo"] * bool(unable),
            *["motion controller"] * (MotionState.ABORTED in states),
            *["encoder check"] * (largest > apart),
        ]
        if messages and by == UNDETECTED and fault is not None and k >= begins:
            by, at = messages[0], k + 1 - begins
    return _Trace(tool, by, at, largest)


def _compare_encoders(run: OfflineRun) -> float:
    """Return by how much encoders at motors and at links differ at most, in the links' unit."""
    session = run.session
    scene, measured = session.scene, session.measured
    apart = [0.0]
    for j, joint in enumerate(scene.joints):
        link = joint.sensors.link_encoder
        if link is not None and not link.wrap and joint.sensors.parts:
            q = measured.encoder_counts[j] * session.plant.link_angle_per_count[j]
            apart.append(abs(q - measured.link_encoder_counts[j] / link.counts_per_rad))
    return float(max(apart))


def _make_row(run: OfflineRun, fault: SceneFault, sound: _Trace, trace: _Trace) -> FaultRow:
    number, period = fault.varied.number, run.motion_ticks * run.session.scene.servo_period
    begins = math.ceil(BEGINS / period)
    end = len(trace.tool) if trace.by == UNDETECTED else min(len(trace.tool), begins + trace.at)
    pairs = zip(trace.tool[:end], sound.tool[:end], strict=True)
    travel = max((float(np.linalg.norm(a - b)) for a, b in pairs), default=0.0)
    after = math.nan if trace.by == UNDETECTED else trace.at * period
    magnitude = float(number.default)
    return FaultRow(fault.name, fault.kind.name, magnitude, number.unit, trace.by, after, travel)


def find_worst(rows: Iterable[FaultRow]) -> list[FaultRow]:
    """Return of each kind the row with the largest travel, the largest first."""
    worst: dict[str, FaultRow] = {}
    for row in rows:
        if row.kind not in worst or row.travel > worst[row.kind].travel:
            worst[row.kind] = row
    return sorted(worst.values(), key=lambda row: -row.travel)


def write_csv(rows: Sequence[FaultRow], file: Path) -> None:
    """Write all rows."""
    with file.open("w", newline="", encoding="utf-8") as out:
        writer = csv.DictWriter(out, [field.name for field in fields(FaultRow)])
        writer.writeheader()
        writer.writerows(map(asdict, rows))


def draw_matrix(rows: Sequence[FaultRow], title: str, file: Path) -> None:
    """Write a picture: of each kind the largest travel, in the colour of who detects it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    worst = find_worst(rows)[::-1]
    figure = Figure(figsize=(8.0, 0.9 + 0.2 * len(worst)), layout="constrained")
    axes = figure.subplots()
    travel = [max(1e-3, 1e3 * row.travel) for row in worst]
    axes.barh([row.fault for row in worst], travel, color=[COLOURS[r.detected_by] for r in worst])
    for place, row in enumerate(worst):
        if row.detected_by != UNDETECTED:
            axes.text(travel[place], place, f" {1e3 * row.after:.0f} ms", va="center", fontsize=7)
    axes.set(xscale="log", xlabel="tool off its way until then, or to the end [mm]", title=title)
    axes.tick_params(axis="y", labelsize=7)
    axes.margins(y=0.01)
    axes.set_xlim(right=3.0 * travel[-1])
    there = [name for name in COLOURS if name in {row.detected_by for row in worst}]
    axes.legend(handles=[Patch(color=COLOURS[name], label=name) for name in there],
                loc="lower right", title="detected by")  # fmt: skip
    FigureCanvasAgg(figure)
    figure.savefig(file)
