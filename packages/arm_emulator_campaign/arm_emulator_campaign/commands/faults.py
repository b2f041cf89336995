"""List the faults that a scene may have, or try each of them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.extension.commands import SceneName, command, output
from arm_emulator.extension.machine import load_scene
from arm_emulator_campaign.fault_matrix import draw_matrix, find_worst, try_faults, write_csv


@command(keys="`scene`, `faults`; with the option matrix `matrix`")
def show_faults(
    scene: SceneName = "three_axis",
    /,
    *,
    matrix: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
) -> int:
    """List the faults that a scene may have, and which of them it lists.

    Args:
        matrix: try each fault in a move of the tool; write who detects it, after how long, and how
            far the tool leaves its way meanwhile, as CSV and as a picture.
    """
    if matrix is not None:
        return _try_faults(scene, matrix)
    machine = load_scene(scene)
    if not machine.faults:
        machine = load_scene(scene, {"faults": []})
    listed = {fault.name for fault in machine.faults}
    rows = [("fault", "listed", "magnitude", "range", "effect")]
    for fault in machine.possible_faults:
        number = fault.varied.number
        there = "yes" if fault.name in listed else ""
        well = f"{number.default:g} {number.unit.removesuffix('1')}".rstrip()
        low, high = number.ends
        rows.append((fault.name, there, well, f"{low:g} to {high:g}", fault.kind.text))
    output.print_line(f"faults of {machine.name}; {len(listed)} are listed in {machine.where}")
    # Without a table's frame and folding: for `grep`, and for narrow terminals.
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        output.print_line("  ".join(cells).rstrip())
    output.add_facts(
        {
            "scene": machine.name,
            "faults": [
                {
                    "name": fault.varied.name, "listed": fault.name in listed,
                    "text": fault.kind.text,
                    "unit": fault.varied.number.unit, "shows_well": fault.varied.number.default,
                    "range": fault.varied.number.ends,
                    "changes": {change.number: change.expression for change in fault.changes},
                }
                for fault in machine.possible_faults
            ],
        }
    )  # fmt: skip
    return 0


def _try_faults(scene: str, folder: Path) -> int:
    """Try each fault, write the matrix, and print the worst joint of each kind."""
    rows = try_faults(scene)
    folder.mkdir(parents=True, exist_ok=True)
    write_csv(rows, folder / "faults.csv")
    draw_matrix(rows, f"Faults of {Path(scene).stem} in a move of 71 mm", folder / "faults.png")
    for row in find_worst(rows):
        after = "" if row.after != row.after else f" after {1e3 * row.after:.0f} ms"
        detection = f"{row.detected_by}{after}"
        output.print_line(
            f"{row.fault:<40} {detection:<32} tool {1e3 * row.travel:.3g} mm off its way"
        )
    output.print_line(f"matrix  {folder / 'faults.csv'}, {folder / 'faults.png'}")
    output.add_facts({"scene": scene, "matrix": rows})
    return 0
