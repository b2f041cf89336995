"""Vibration of the tool after a fast line, with and without input shaping.

    python -m bench.motion.vibration [SCENE ...]

prints the table of scenes of yours.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator import OfflineRun, Plant, Pose, load_gains, load_scene
from arm_emulator.analysis.residual_vibration import find_reference_end, measure_vibration
from arm_emulator.analysis.vibration_modes import find_vibration_modes
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.design.new_scene import list_drive_parameters
from arm_emulator.motion.executor.motion_executor import MotionExecutor
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.input_shaper import ShapedMode
from arm_emulator.motion.planner.tool_controller import make_controller
from arm_emulator.servo.servo_config import ServoConfig
from bench.measure import show_progress
from bench.pictures import make_figure, save_picture
from bench.tables import format_table

TITLE = "Vibration after a fast line"

SLIDES = "joints.*.friction.coulomb"  # without it a joint does not stick after its motion
SCENES = (
    "ur5",
    f"ur5, {SLIDES}",
    str(Path(__file__).resolve().parents[2] / "config/validation/kr560/kr560.yaml"),
)
LENGTH, SPEED, ACCELERATION = 0.3, 1.0, 10.0  # m, m/s, m/s2
AT_ONCE = 1e5  # m/s3 and rad/s3: the acceleration jumps, as planners of shortest time command it
SETTLE, SETTLED_WINDOW = 5.0, 1.0  # s, before and after the line
STIFF = 6.0  # times the velocity gains: motors that their drives hold firmly
SHAPED = 2  # modes
BAND = 1e-4  # m
WRONG = (0.8, 0.9, 1.1, 1.2)
KINDS = ("none", "zv", "zvd")
PICTURE = "vibration"


def run_bench(quick: bool, scenes: Sequence[str] = SCENES) -> dict[str, Any]:
    """Measure each scene with each servo, feed-forward and shaper."""
    rows, curves = [], {}
    chosen = list(scenes)[: 1 if quick else None]
    with show_progress("lines", len(chosen) * 2) as done:
        for scene in chosen:
            for stiff in (1.0, STIFF):
                arm = _ArmAtLine(scene, stiff)
                for kind_of in ("torque", "full"):
                    for kind in KINDS:
                        row = arm.follow_line(kind_of, kind)
                        if kind != "none":
                            wrong = [arm.follow_line(kind_of, kind, factor) for factor in WRONG]
                            row["wrong"] = [wrong_row["swing"] for wrong_row in wrong]
                        if kind_of == "torque" and stiff == STIFF:
                            curves[f"{arm.name}, {kind}"] = row["curve"]
                        rows.append({key: row[key] for key in row if key != "curve"})
                done(f"{arm.name}, {stiff:g}")
    return {"rows": rows, "curves": curves}


class _ArmAtLine:
    """An arm at rest where its line begins.

    Args:
        scene: name or file, and a number of it that is left out.
        stiff: factor of the servo's velocity gains.
    """

    def __init__(self, scene: str, stiff: float) -> None:
        name, _, without = scene.partition(", ")
        file = find_scene(name)
        self.scene = load_scene(file, {without: None} if without else {})
        self.gains, self.stiff = load_gains(file), stiff
        self.name = f"{self.scene.name} without dry friction" if without else self.scene.name
        joints = tuple(
            dataclasses.replace(joint, velocity_gain=stiff * joint.velocity_gain)
            for joint in self.gains.servo.joints
        )
        self.servo: ServoConfig = dataclasses.replace(self.gains.servo, joints=joints)
        vibration_modes = find_vibration_modes(Plant(self.scene), self.servo, self.scene.start)
        self.modes = [ShapedMode(mode.frequency, mode.damping) for mode in vibration_modes[:SHAPED]]

    def follow_line(self, feedforward: str, kind: str, factor: float = 1.0) -> dict[str, Any]:
        """Measure a line shaped for modes whose frequencies are wrong by a factor."""
        modes = tuple(ShapedMode(factor * mode.frequency, mode.damping) for mode in self.modes)
        motion: MotionConfig = dataclasses.replace(
            self.gains.motion,
            feedforward=feedforward,
            tool_path_tolerance=0.0,
            tool_speed=SPEED,
            tool_acceleration=ACCELERATION,
            tool_jerk=AT_ONCE,
            jerk_limit=AT_ONCE,
            acceleration_limit=50.0,
            shaper=kind,
            modes=modes,
            drives=list_drive_parameters(self.scene.joints),
        )
        run = OfflineRun(self.scene, self.servo, motion)
        run.controller = make_controller(
            self.scene.urdf, run.controller.kinematics.joint_names, motion
        )
        run.instructor = MotionExecutor(motion)
        period = self.scene.servo_period
        run.advance(round(SETTLE / period))
        kinematics = run.controller.kinematics
        R_WT, start = kinematics.forward(_read_reference(run))
        along = np.array([0.0, 1.0, 0.0])
        ends = Pose(start, R_WT), Pose(start + LENGTH * along, R_WT)
        run.instructor.add_path(run.controller, ends)
        places, targets, tools = [], [], []
        delay = motion.design_shaper().delay
        for _ in range(round((1.5 + delay + SETTLED_WINDOW) / motion.period)):
            for _ in range(run.motion_ticks):
                run.advance(1)
                places.append(kinematics.forward(run.session.state.q)[1])
            targets.append(_read_reference(run))
            tools.append(kinematics.forward(targets[-1])[1] - start)
        tool, reference = np.array(places), np.array(tools)
        end = find_reference_end(np.array(targets)) * run.motion_ticks
        after = tool[end : end + round(SETTLED_WINDOW / period)]
        vibration = measure_vibration(after, period, BAND)
        unshaped = end * period - delay
        speed = np.linalg.norm(np.diff(reference, axis=0), axis=1).max() / motion.period
        beside = reference - np.outer(reference @ along, along)
        first = max(0, end - round((delay + 0.1) / period))
        t = period * np.arange(first, end + round(0.5 / period)) - unshaped
        off = tool[first : end + round(0.5 / period)] - tool[end + len(after) - 1]
        return {
            "scene": self.name,
            "stiff": self.stiff,
            "feedforward": feedforward,
            "kind": kind,
            "modes": [(mode.frequency, mode.damping) for mode in self.modes],
            "speed": float(speed),
            "delay": delay,
            "beside": float(np.linalg.norm(beside, axis=1).max()),
            **dataclasses.asdict(vibration),
            "curve": {"t": t.tolist(), "off": off[:, 2].tolist()},
        }


def _read_reference(run: OfflineRun) -> np.ndarray:
    """Return the angles of the links that the servo was asked for last (N,)."""
    target: np.ndarray = run.drives.servo.state["q_target"] - run.wind_up
    return target


def write_report(figures: dict[str, Any]) -> str:
    """Return the section of the report."""
    lines = [
        f"A line of {LENGTH * 1e3:g} mm along y at {SPEED:g} m/s, whose acceleration of "
        f"{ACCELERATION:g} m/s² begins and ends at once; joints that are too slow for it lower its "
        "speed. Servo: its velocity gains by those of `tune`. Modes: those that swing the tool "
        "most at the start, for which the shaper is designed. The tool after the end of the "
        "shaped reference, against where it rests a second later: half of the largest way "
        "between turning points (swing), the largest deviation, creeping included, and the time "
        f"until it stays within {BAND * 1e3:g} mm, from the end of the unshaped reference. Wrong: "
        "the swing where the frequencies of the shaper are 0.8, 0.9, 1.1 and 1.2 times the true "
        "ones. Beside: distance of the shaped reference from the line.",
        "",
    ]
    rows = []
    for row in figures["rows"]:
        modes = ", ".join(f"{f:.1f} Hz ({damping:.2f})" for f, damping in row["modes"])
        wrong = " ".join(f"{1e3 * swing:.3f}" for swing in row.get("wrong", ()))
        rows.append((
            row["scene"], f"x {row['stiff']:g}", modes, row["feedforward"], row["kind"],
            f"{row['speed']:.2f} m/s", f"{1e3 * row['delay']:.0f} ms",
            f"{1e3 * row['swing']:.3f} mm", f"{1e3 * row['largest']:.2f} mm",
            f"{1e3 * (row['delay'] + row['settled']):.0f} ms", wrong,
            f"{1e3 * row['beside']:.2f} mm",
        ))  # fmt: skip
    heads = ("scene", "servo", "modes (damping)", "feed-forward", "shaper", "speed", "delay",
             "swing", "largest", "within 0.1 mm", "wrong, mm", "beside")  # fmt: skip
    return "\n".join([*lines, format_table(heads, rows)])


def draw_figures(figures: dict[str, Any], folder: Path) -> None:
    """Draw the tool about its rest over time, a scene beside the other."""
    names = list(dict.fromkeys(name.rpartition(", ")[0] for name in figures["curves"]))
    figure = make_figure(3.6 * len(names), 3.2)
    for axes, name in zip(figure.subplots(1, len(names), squeeze=False)[0], names, strict=True):
        curves = [figures["curves"][f"{name}, {kind}"] for kind in KINDS]
        for kind, curve in zip(KINDS, curves, strict=True):
            axes.plot(curve["t"], [1e3 * off for off in curve["off"]], label=kind)
        axes.set(xlabel="t after the unshaped reference [s]", title=f"{name}, firm drives")
        axes.set_xlim(-0.1, 0.5)
        limit = 1.2 * max(abs(off) for off in curves[0]["off"][-480:])
        axes.set_ylim(-1e3 * limit, 1e3 * limit)
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("height of the tool above its rest [mm]")
    figure.axes[0].legend(title="shaper")
    save_picture(figure, folder, PICTURE)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="bench.motion.vibration", description=TITLE)
    parser.add_argument("scenes", nargs="*", default=SCENES, help="names or files")
    print(write_report(run_bench(False, parser.parse_args().scenes)))


if __name__ == "__main__":
    main()
