"""docs/reference/faults.md: who detects the faults of the three-axis arm."""

from __future__ import annotations

from pathlib import Path

from arm_emulator.campaign import fault_matrix as matrix
from arm_emulator.campaign.fault_matrix import NOBODY, Row, fault_matrix, worst_by_kind


def run(quick: bool) -> list[Row]:
    """Try all faults."""
    return fault_matrix("three_axis")


def report(rows: list[Row]) -> str:
    """Return the table of the worst joint of each kind."""
    lines = ["| fault | detected by | after | tool off its way |", "|---|---|---|---|"]
    for one in worst_by_kind(rows):
        after = "" if one.detected_by == NOBODY else f"{1e3 * one.after:.0f} ms"
        lines.append(f"| `{one.fault}` | {one.detected_by} | {after} | {1e3 * one.travel:.2g} mm |")
    return "\n".join(lines)


def draw(rows: list[Row], folder: Path) -> Path:
    """Draw the tool's travel until a fault is detected; return the picture's file."""
    picture = folder / "faults.png"
    matrix.draw(rows, "Faults of three_axis in a move of 71 mm and back", picture)
    return picture
