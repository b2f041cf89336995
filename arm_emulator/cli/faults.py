"""`arm_emulator faults`: the faults that a scene may have."""

from __future__ import annotations

from arm_emulator.cli.output import Output
from arm_emulator.machine.scene import load_scene


def list_faults(scene_name: str, *, json: bool) -> int:
    """Print each fault with its magnitude and what it changes."""
    output, scene = Output(json), load_scene(scene_name)
    if not scene.faults:
        scene = load_scene(scene_name, {"faults": []})
    listed = {one.name for one in scene.faults}
    rows = [("fault", "listed", "magnitude", "range", "effect")]
    for one in scene.possible_faults:
        number = one.varied.number
        there = "yes" if one.name in listed else ""
        well = f"{number.default:g} {number.unit.removesuffix('1')}".rstrip()
        low, high = number.ends
        rows.append((one.name, there, well, f"{low:g} to {high:g}", one.kind.text))
    output.line(f"faults of {scene.name}; {len(listed)} are listed in {scene.where}")
    # Without a table's frame and folding: for `grep`, and for narrow terminals.
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        output.line("  ".join(cells).rstrip())
    output.facts(
        {
            "scene": scene.name,
            "faults": [
                {
                    "name": one.varied.name, "listed": one.name in listed, "text": one.kind.text,
                    "unit": one.varied.number.unit, "shows_well": one.varied.number.default,
                    "range": one.varied.number.ends,
                    "changes": {change.number: change.expression for change in one.changes},
                }
                for one in scene.possible_faults
            ],
        }
    )  # fmt: skip
    return 0
