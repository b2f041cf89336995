"""Table of the eigenvalues of every loop of a scene's drives."""

from __future__ import annotations

from collections.abc import Iterable

from arm_emulator.analysis.mode_loops import LoopFigure, ModeLoops
from arm_emulator.machine.scene import Scene
from arm_emulator.servo.servo_config import ServoConfig

HEADS = (
    "joint",
    "loop",
    "largest",
    "slowest swing",
    "brake closed: largest",
    "slowest swing",
    "growth, 1/s",
    "",
)
_NONE = 1e-3  # 1/s: rounding of an eigenvalue 0


def mode_rows(scene: Scene, servo: ServoConfig) -> list[tuple[str, ...]]:
    """Return a row of `HEADS` for each joint and loop, and one of all joints in each loop."""
    rows = []
    figures = ModeLoops(scene, servo).figures
    for alike in (True, False):
        of_rows: dict[tuple[int, str], list[LoopFigure]] = {}
        for one in figures:
            if one.alike is alike:
                key = -1 if alike else one.joint, one.loop.value
                of_rows.setdefault(key, []).append(one)
        for (j, loop), pair in sorted(of_rows.items(), key=lambda item: item[0][0]):
            name = "all" if alike else scene.joint_names[j]
            rows.append((name, loop, *_cells(pair)))
    return rows


def mode_facts(scene: Scene, servo: ServoConfig) -> list[dict[str, object]]:
    """Return the same for programs, a row for each loop with brakes open or closed."""
    return [
        {
            "joint": "all" if one.alike else scene.joint_names[one.joint],
            "loop": one.loop.value,
            "braked": one.braked,
            "radius": one.radius,
            "swing": one.swing,
            "frequency": one.frequency,
            "growth": one.beyond,
            "gain": one.gain,
            "holds": one.holds,
        }
        for one in ModeLoops(scene, servo).figures
    ]


def _cells(pair: Iterable[LoopFigure]) -> tuple[str, ...]:
    by_brake = {one.braked: one for one in pair}
    cells: list[str] = []
    for braked in (False, True):
        one = by_brake.get(braked)
        cells.append("" if one is None else f"{one.radius:.4f}")
        swings = one is not None and one.swing > 0.0
        cells.append(f"{one.swing:.4f} at {one.frequency:.3g} Hz" if one and swings else "")
    worst = max(by_brake.values(), key=lambda one: one.beyond)
    gain = f", {worst.gain:g} of the command" if worst.gain != 1.0 else ""
    cells.append(f"{worst.beyond if abs(worst.beyond) > _NONE else 0.0:.3g}{gain}")
    cells.append("" if worst.holds else "withheld")
    return tuple(cells)


def page_table(rows: list[tuple[str, ...]]) -> str:
    """Return rows as a table in Markdown."""
    lines = [HEADS, ("---",) * len(HEADS), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
