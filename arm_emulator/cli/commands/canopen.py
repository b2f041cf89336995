"""Serve a CANopen master with a CiA 402 drive per joint."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.base.kept import NOTHING
from arm_emulator.cli.command import command
from arm_emulator.cli.options import Clock, Keep, SceneName


@command(until_stopped=True)
def canopen(
    scene: SceneName = "three_axis",
    /,
    *,
    listen: Annotated[str, Parameter(metavar="[HOST:]PORT")] = "127.0.0.1:29536",
    bus: str | None = None,
    channel: str | None = None,
    bitrate: int | None = None,
    first_node: Annotated[int, Parameter(metavar="ID")] = 1,
    clock: Clock = "lockstep",
    eds: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
    kept: Keep = NOTHING,
) -> int:
    """Serve CANopen masters until Ctrl-C.

    Args:
        listen: address of the bus, served as by socketcand.
        bus: instead, a bus of python-can: socketcan, udp_multicast, ...
        channel: of that bus, such as can0.
        bitrate: for buses that need it.
        first_node: node-ID of the first joint; the others follow.
        eds: folder for the drives' data sheets, which are written instead.
    """
    from arm_emulator.cli.canopen import canopen as serve
    from arm_emulator.cli.canopen import write_eds

    kept.check("canopen")
    if eds is not None:
        return write_eds(scene, eds)
    return serve(
        scene,
        listen=listen,
        bus=bus,
        channel=channel,
        bitrate=bitrate,
        first=first_node,
        clock=clock,
        kept=kept,
    )
