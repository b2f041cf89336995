"""Run unmodified firmware of a Cortex-M4F in the loop with a machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.base.kept import NOTHING
from arm_emulator.cli.command import command
from arm_emulator.cli.options import Keep, SceneName, Seconds, TargetFile


@command()
def firmware(
    board: Path,
    firmware: Path,
    /,
    *,
    scene: SceneName = "three_axis",
    targets: TargetFile = None,
    seconds: Seconds = None,
    gdb: Annotated[int | None, Parameter(metavar="PORT")] = None,
    uart: Annotated[list[str] | None, Parameter(metavar="NAME=WHERE ...")] = None,
    kept: Keep = NOTHING,
) -> int:
    """Run unmodified firmware of a microcontroller in the loop with a machine.

    Args:
        board: wiring of the registers (YAML).
        firmware: ELF file.
        gdb: port on 127.0.0.1 at which to wait for gdb.
        uart: a serial line of the board: stdout, pty or none (default: the first to stdout).
    """
    from arm_emulator.cli.firmware import run

    kept.check("firmware")
    return run(
        board,
        firmware,
        scene,
        targets=targets,
        seconds=seconds,
        gdb=gdb,
        uarts=uart or (),
        kept=kept,
    )
