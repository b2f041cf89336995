"""Compute a servo's gains; margins, steps, encoders."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.cli.command import command
from arm_emulator.cli.options import Json, SceneName


@command()
def tune(
    scene: SceneName = "three_axis",
    /,
    *,
    out: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
    payload: Annotated[float | None, Parameter(metavar="KG")] = None,
    write: bool = False,
    json: Json = False,
) -> int:
    """Compute gains for a scene, and compare them with the present ones.

    Args:
        out: folder of a picture.
        payload: mass at the tool, instead of the scene's.
        write: write the gains into the servo's file.
    """
    from arm_emulator.cli.tune import tune as compute

    return compute(scene, out, payload, write=write, json=json)
