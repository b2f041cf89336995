"""Simulate many varied runs of one scenario, and count how often its requirements fail."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.base.kept import NOTHING
from arm_emulator.cli.command import command
from arm_emulator.cli.options import Json, Keep


@command()
def campaign(
    file: Annotated[Path, Parameter(metavar="FILE")],
    /,
    *,
    into: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
    count: Annotated[int | None, Parameter(metavar="N")] = None,
    workers: Annotated[int | None, Parameter(metavar="N")] = None,
    dask: Annotated[str | None, Parameter(metavar="ADDRESS")] = None,
    dry: bool = False,
    replay: Annotated[int | None, Parameter(metavar="INDEX")] = None,
    kept: Keep = NOTHING,
    json: Json = False,
) -> int:
    """Simulate the runs of a campaign and report how often its requirements fail.

    Ctrl-C keeps all that is done; the same command goes on with what is missing.

    Args:
        file: the campaign, YAML.
        into: results and report (default: out/campaigns/NAME).
        count: runs in all, in the place of the file's count.
        workers: processes (default: one for each processor core).
        dask: scheduler of a Dask cluster, whose workers see the same files.
        dry: measure what a run costs, print time and size of the whole, and simulate nothing more.
        replay: simulate one run again, for --record and --rerun.
    """
    from arm_emulator.cli.campaign import Options
    from arm_emulator.cli.campaign import campaign as work

    return work(file, Options(into, count, workers, dask, dry, replay, kept), json=json)
