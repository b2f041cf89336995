"""`arm_emulator faults`: the faults that a scene may have."""

from __future__ import annotations

from rich.table import Table

from arm_emulator.cli.output import Output
from arm_emulator.machine.scene import load_scene


def list_faults(scene_name: str, *, json: bool) -> int:
    """Print each fault with its magnitude and what it changes."""
    output, scene = Output(json), load_scene(scene_name)
    if not scene.faults:
        scene = load_scene(scene_name, {"faults": []})
    listed = {one.name for one in scene.faults}
    table = Table(title=f"faults of {scene.name}, {len(listed)} of them listed in {scene.where}")
    for column in ("fault", "listed", "shows well", "range", "what happens"):
        table.add_column(column, overflow="fold")
    for one in scene.possible_faults:
        number = one.varied.number
        there = "yes" if one.name in listed else ""
        well = f"{number.default:g} {number.unit.removesuffix('1')}".rstrip()
        low, high = number.ends
        table.add_row(one.name, there, well, f"{low:g} to {high:g}", one.kind.text)
    output.console().print(table)
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
