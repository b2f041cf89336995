"""Serve a Modbus RTU master as the paper's data converter on a serial port."""

import contextlib
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from arm_emulator.extension.base import KEEP_NOTHING, Refusal
from arm_emulator.extension.commands import Keep, PageAt, SceneName, command, output, serve_session
from arm_emulator.extension.machine import load_scene
from arm_emulator_fieldbus.converter import RegisterConverter, list_blocks
from arm_emulator_fieldbus.modbus_line import ModbusLine
from arm_emulator_fieldbus.modbus_pty import RealTimeService, SerialPort, serve_port
from arm_emulator_fieldbus.modbus_rtu import LARGEST_STATION
from arm_emulator_fieldbus.serial_line import LARGEST_BAUD, LineErrors


@command(
    until_stopped=True,
    keys=(
        "`scene`, `port`, `link`, `station`, `baud`, `clock`; with the option registers `registers`"
    ),
)
def serve_modbus(
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
    page: PageAt = None,
    outputs: Keep = KEEP_NOTHING,
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
    outputs.check_options("modbus")
    if registers:
        return _print_registers(scene)
    if not 50 <= baud <= LARGEST_BAUD:
        raise Refusal("modbus", "baud", f"be 50 to {LARGEST_BAUD} bit/s", baud)
    if not 1 <= station <= LARGEST_STATION:
        raise Refusal("modbus", "station", f"be 1 to {LARGEST_STATION}", station)
    errors = LineErrors(error_rate, seed)
    machine = load_scene(scene)
    with (
        serve_session(machine, clock, outputs, page) as session,
        contextlib.closing(SerialPort(baud, link)) as port,
    ):
        converter = RegisterConverter(session, watchdog)
        at = f"{port.path}{f' ({link})' if link else ''}"
        output.add_facts({
            "scene": machine.name, "port": port.path, "link": link, "station": station,
            "baud": baud, "clock": clock,
        })  # fmt: skip
        print(f"modbus: scene {machine.name} ({len(machine.joints)} joints), station {station}")
        print(f"modbus: {at}, {baud} baud, clock {clock}", flush=True)
        line = ModbusLine(converter, station, clock, baud, errors)
        if clock == "realtime":
            RealTimeService(port, line).serve_masters()
        else:
            serve_port(port, line)
    return 0


def _print_registers(scene: str) -> int:
    """Print the table of registers of a scene.

    Raises:
        Refusal: the scene is refused.
    """
    table = list_blocks(load_scene(scene))
    for block in table:
        last = block.address + block.count - 1
        where = f"{block.address}" if block.count == 1 else f"{block.address} to {last}"
        access = "rw" if block.writable else "r"
        per = f" [{block.per} per joint]" if block.per else ""
        text = f"{where:<16} {access:<3} {block.kind:<8} {block.name}{per}, {block.unit}"
        output.print_line(text.rstrip(", "))
    output.add_facts({"registers": table})
    return 0
