"""Find the cheapest scheme and step for an error."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.cli.command import command
from arm_emulator.cli.options import Json, SceneName


@command()
def advise(
    scene: SceneName = "three_axis",
    /,
    *,
    error: float = 1e-4,
    motion: Annotated[Path | None, Parameter(metavar="FILE")] = None,
    write: bool = False,
    json: Json = False,
) -> int:
    """Find the cheapest scheme, events and step that keep an error.

    Args:
        error: largest error of a link on the way (rad or m).
        motion: test motion: a bag, or a CSV of commands with t and the joints' names (default: the
            scene's demo and motions of many kinds).
        write: put the result into the scene file.
    """
    from arm_emulator.cli.advise import advise_scene

    return advise_scene(scene, error, motion, write=write, json=json)
