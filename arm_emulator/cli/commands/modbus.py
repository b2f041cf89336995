"""Serve a Modbus RTU master as the paper's data converter on a serial port."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from arm_emulator.base.kept import NOTHING
from arm_emulator.cli.command import command
from arm_emulator.cli.options import Keep, SceneName


@command(until_stopped=True)
def modbus(
    scene: SceneName = "three_axis",
    /,
    *,
    clock: Literal["lockstep", "line", "realtime"] = "lockstep",
    baud: int = 115_200,
    station: int = 1,
    error_rate: Annotated[float, Parameter(metavar="SHARE")] = 0.0,
    seed: int = 0,
    watchdog: Annotated[int, Parameter(metavar="MS")] = 100,
    link: Annotated[Path | None, Parameter(metavar="PATH")] = None,
    registers: bool = False,
    kept: Keep = NOTHING,
) -> int:
    """Serve Modbus RTU masters until Ctrl-C.

    Args:
        clock: a servo period per write of commands, logical time by the duration of the line's
            traffic, or the wall clock.
        baud: of the line.
        station: address on the line.
        error_rate: share of bytes lost or damaged on the line.
        seed: of these errors.
        watchdog: time after which the drives of a silent master are off; 0: never.
        link: symbolic link to the port.
        registers: print the table of registers, and end.
    """
    from arm_emulator.cli.modbus import modbus as serve
    from arm_emulator.cli.modbus import print_registers

    kept.check("modbus")
    if registers:
        return print_registers(scene)
    return serve(
        scene,
        clock=clock,
        baud=baud,
        station=station,
        error_rate=error_rate,
        seed=seed,
        watchdog=watchdog,
        link=link,
        kept=kept,
    )
