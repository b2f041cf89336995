"""Compare a real machine with measurements or with independent solutions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.cli.command import command
from arm_emulator.cli.options import Json


@command()
def validate(
    machine: str,
    /,
    *runs: Path,
    out: Annotated[Path, Parameter(metavar="FOLDER")] = Path("out"),
    json: Json = False,
) -> int:
    """Compare the emulation of a real machine with measurements or with independent solutions.

    Args:
        machine: manutec_r3 or kuka_kr300.
        runs: of kuka_kr300: further records (default: those shipped).
        out: folder of the pictures.
    """
    from arm_emulator.cli.validate import validate as compare

    return compare(machine, runs, out, json=json)
