"""List the faults that a scene may have."""

from __future__ import annotations

from arm_emulator.cli.command import command
from arm_emulator.cli.options import SceneName
from arm_emulator.cli.output import output
from arm_emulator.machine.scene import load_scene


@command(keys="`scene`, `faults`")
def faults(scene: SceneName = "three_axis", /) -> int:
    """List the faults that a scene may have, and which of them it lists."""
    machine = load_scene(scene)
    if not machine.faults:
        machine = load_scene(scene, {"faults": []})
    listed = {one.name for one in machine.faults}
    rows = [("fault", "listed", "magnitude", "range", "effect")]
    for one in machine.possible_faults:
        number = one.varied.number
        there = "yes" if one.name in listed else ""
        well = f"{number.default:g} {number.unit.removesuffix('1')}".rstrip()
        low, high = number.ends
        rows.append((one.name, there, well, f"{low:g} to {high:g}", one.kind.text))
    output.line(f"faults of {machine.name}; {len(listed)} are listed in {machine.where}")
    # Without a table's frame and folding: for `grep`, and for narrow terminals.
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        output.line("  ".join(cells).rstrip())
    output.facts(
        {
            "scene": machine.name,
            "faults": [
                {
                    "name": one.varied.name, "listed": one.name in listed, "text": one.kind.text,
                    "unit": one.varied.number.unit, "shows_well": one.varied.number.default,
                    "range": one.varied.number.ends,
                    "changes": {change.number: change.expression for change in one.changes},
                }
                for one in machine.possible_faults
            ],
        }
    )  # fmt: skip
    return 0
