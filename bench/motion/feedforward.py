"""Distance of the true tool from its reference on a fast line, by the feed-forward.

    python -m bench.motion.feedforward [SCENE ...]

prints the table of scenes of yours. KUKA's KR 300 is made by `new` from the description in config.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from arm_emulator.design.new_scene import write_new
from bench.measure import show_progress
from bench.pictures import make_figure, save_picture
from bench.tables import format_table
from oracles.followed_line import AssumedNumbers, ToolLine, follow_line

TITLE = "Feed-forward on a fast line"

ROOT = Path(__file__).resolve().parents[2]
SCENES = "ur5", "panda", "kuka_kr300"
WITHOUT_SERVO = {
    "kuka_kr300": ROOT / "config" / "urdf" / "kuka_kr300.urdf"
}  # scenes without a servo
CASES = {
    "none": AssumedNumbers("none"),
    "speed": AssumedNumbers("speed"),
    "torque": AssumedNumbers("torque"),
    "full": AssumedNumbers("full"),
    "full, all 30 % too small": AssumedNumbers("full", stiffness=0.7, friction=0.7, inertia=0.7),
    "full, all 30 % too large": AssumedNumbers("full", stiffness=1.3, friction=1.3, inertia=1.3),
    "full, gears 30 % too soft, inertia 30 % too large": AssumedNumbers("full", 0.7, 1.3, 1.3),
    "full, gears 30 % too stiff, inertia 30 % too small": AssumedNumbers("full", 1.3, 0.7, 0.7),
    "full, all 50 % too small": AssumedNumbers("full", stiffness=0.5, friction=0.5, inertia=0.5),
    "full, all 50 % too large": AssumedNumbers("full", stiffness=1.5, friction=1.5, inertia=1.5),
}
PICTURED = "speed", "torque", "full, all 30 % too small", "full"
PICTURE = "feedforward"


def run_bench(quick: bool, scenes: Sequence[str] = SCENES) -> dict[str, Any]:
    """Measure each scene with each case."""
    rows, curves = [], {}
    chosen = list(scenes)[: 1 if quick else None]
    with (
        tempfile.TemporaryDirectory() as folder,
        show_progress("lines", len(chosen) * len(CASES)) as done,
    ):
        for name in chosen:
            scene = (
                name
                if name not in WITHOUT_SERVO
                else str(_make_scene(WITHOUT_SERVO[name], Path(folder) / name))
            )
            for case, assumed in CASES.items():
                followed = follow_line(scene, assumed)
                again = (
                    follow_line(scene, assumed, practised=True)
                    if assumed.feedforward == "full"
                    else None
                )
                rows.append(
                    {
                        "scene": Path(scene).stem,
                        "case": case,
                        "off": followed.off,
                        "again": None if again is None else again.off,
                        "behind": followed.behind,
                        "past": followed.past,
                        "unseen": followed.unseen,
                        "peak_speed": followed.peak_speed,
                    }
                )
                if name == chosen[0]:
                    off = (followed.deviation**2).sum(axis=1) ** 0.5
                    curves[case] = {"t": (followed.t - followed.t[0]).tolist(), "off": off.tolist()}
                done(f"{name}, {case}")
    return {"rows": rows, "curves": curves}


def _make_scene(robot: Path, folder: Path) -> Path:
    """Return the scene of a robot description, with servo and motion controller."""
    return write_new(robot, folder).file


def write_report(figures: dict[str, Any]) -> str:
    """Return the section of the report."""
    line = ToolLine()
    lines = [
        f"A line of {line.length * 1e3:g} mm along y at {line.speed:g} m/s, {line.acceleration:g} "
        f"m/s² and {line.jerk:g} m/s³, orientation held: the largest distance of the true tool "
        "from its reference, the part of it along the line, how far the tool goes past the end, "
        "and the distance that would remain if every motor were exactly where it is sent: what no "
        "encoder at a motor can see. Joints that are too slow for the line lower its speed. It is "
        "the first motion after the start; `again`: off, once the tool has gone there and back.",
        "",
    ]
    rows = []
    for row in figures["rows"]:
        cells = (
            "" if (value := row[key]) is None else f"{value * 1e3:.2f} mm"
            for key in ("off", "again", "behind", "past", "unseen")
        )
        rows.append((row["scene"], row["case"], f"{row['peak_speed']:.2f} m/s", *cells))
    heads = ("scene", "feed-forward", "speed", "off", "again", "along", "past the end", "unseen")
    return "\n".join([*lines, format_table(heads, rows)])


def draw_figures(figures: dict[str, Any], folder: Path) -> None:
    """Draw the distance of the tool from its reference over time."""
    figure = make_figure(7.0, 3.2)
    axes = figure.add_subplot()
    for name in PICTURED:
        curve = figures["curves"][name]
        axes.plot(curve["t"], [1e3 * off for off in curve["off"]], label=name)
    axes.set_xlabel("t [s]")
    axes.set_ylabel("true tool off its reference [mm]")
    axes.set_xlim(0.0, 1.2)
    axes.set_ylim(bottom=0.0)
    axes.legend()
    save_picture(figure, folder, PICTURE)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="bench.motion.feedforward", description=TITLE)
    parser.add_argument("scenes", nargs="*", default=SCENES, help="names or files")
    print(write_report(run_bench(False, parser.parse_args().scenes)))


if __name__ == "__main__":
    main()
