"""Write the machine as a unit for simulators (FMI)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from arm_emulator.cli.command import command
from arm_emulator.cli.options import SceneName


@command()
def fmu(
    scene: SceneName,
    /,
    *,
    out: Annotated[Path, Parameter(metavar="FILE")],
    varied: Annotated[str | None, Parameter(metavar="NAMES")] = None,
    target: str | None = None,
    fmi: Literal["3", "2"] = "3",
    windows: bool = False,
) -> int:
    """Write a scene's machine as a functional mock-up unit for co-simulation.

    Args:
        out: file to write, such as arm.fmu.
        varied: parameters, separated by commas (default: numbers that the scene lists).
        target: processors of the binary: a level (default: x86-64-v2), or native, this machine's.
        fmi: version, 3.0 or 2.0.
        windows: add a binary for 64-bit Windows (by mingw).
    """
    from arm_emulator.cli.fmu import write_fmu

    names = None if varied is None else [one for one in varied.split(",") if one]
    return write_fmu(scene, out, names, target, fmi, windows)
