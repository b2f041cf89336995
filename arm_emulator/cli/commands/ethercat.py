"""Serve an EtherCAT master with a CiA 402 drive per joint."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.base.kept import NOTHING
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import command
from arm_emulator.cli.options import Keep, SceneName


@command(until_stopped=True)
def ethercat(
    scene: SceneName = "three_axis",
    /,
    *,
    interface: Annotated[str | None, Parameter(metavar="IF")] = None,
    esi: Annotated[Path | None, Parameter(metavar="FILE")] = None,
    lockstep: bool = False,
    realtime: bool = False,
    kept: Keep = NOTHING,
) -> int:
    """Serve an EtherCAT master until Ctrl-C.

    Args:
        interface: network interface that the master is connected to.
        esi: file for the description of the slaves (ESI), which is written instead.
        lockstep: a servo period per frame of process data (default).
        realtime: servo periods by the clock.
    """
    from arm_emulator.cli.ethercat import serve, write_esi

    kept.check("ethercat")
    if lockstep and realtime:
        raise Refusal("ethercat", "--realtime", "stand without --lockstep", "both")
    if esi is not None:
        return write_esi(scene, esi)
    if interface is None:
        raise Refusal("ethercat", "--interface", "name a network interface", "none")
    return serve(scene, interface, not realtime, kept)
