"""docs/reference/faults.md: who detects the faults of the three-axis arm."""

from __future__ import annotations

from pathlib import Path

from arm_emulator_campaign import fault_matrix as matrix
from arm_emulator_campaign.fault_matrix import UNDETECTED, FaultRow, find_worst, try_faults
from bench.tables import format_table


def run_bench(quick: bool) -> list[FaultRow]:
    """Try all faults."""
    return try_faults("three_axis")


def write_report(rows_of: list[FaultRow]) -> str:
    """Return the table of the worst joint of each kind."""
    rows = []
    for row in find_worst(rows_of):
        after = "" if row.detected_by == UNDETECTED else f"{1e3 * row.after:.0f} ms"
        rows.append((f"`{row.fault}`", row.detected_by, after, f"{1e3 * row.travel:.2g} mm"))
    return format_table(("fault", "detected by", "after", "tool off its way"), rows)


def draw_figures(rows: list[FaultRow], folder: Path) -> Path:
    """Draw the tool's travel until a fault is detected; return the picture's file."""
    picture = folder / "faults.png"
    matrix.draw_matrix(rows, "Faults of three_axis in a move of 71 mm and back", picture)
    return picture
