"""Write the data of a scene's joints as a C header for our servo."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.cli.command import command
from arm_emulator.cli.options import SceneName


@command()
def servo_header(
    scene: SceneName = "three_axis",
    /,
    *,
    out: Annotated[Path | None, Parameter(metavar="FILE")] = None,
) -> int:
    """Write the data of a scene's joints as a C header for our servo.

    Args:
        out: header file (default: the terminal).
    """
    from arm_emulator.cli.servo_header import write_header

    return write_header(scene, out)
