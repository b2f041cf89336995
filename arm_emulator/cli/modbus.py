"""`arm_emulator modbus`: the paper's data converter on a serial port, in Modbus RTU."""

from __future__ import annotations

from pathlib import Path

from arm_emulator.analysis.scene_warnings import warn_of_scene
from arm_emulator.base.kept import NOTHING, Kept
from arm_emulator.base.refusal import Refusal
from arm_emulator.doors.fieldbus.converter import Converter, blocks
from arm_emulator.doors.fieldbus.modbus_line import CLOCKS, ModbusLine
from arm_emulator.doors.fieldbus.modbus_pty import RealTimeService, serial_port, serve
from arm_emulator.doors.fieldbus.modbus_rtu import LARGEST_STATION
from arm_emulator.doors.fieldbus.serial_line import LineErrors, check_baud
from arm_emulator.machine.loop_clock import real_time_session
from arm_emulator.machine.scene import load_scene
from arm_emulator.machine.session import Session
from arm_emulator.runs.recorder import Recorder


def modbus(
    scene_name: str,
    *,
    clock: str,
    baud: int,
    station: int,
    error_rate: float,
    seed: int,
    watchdog: int,
    link: Path | None,
    kept: Kept = NOTHING,
) -> int:
    """Serve masters until Ctrl-C.

    Raises:
        Refusal: an option or the scene is refused.
    """
    if clock not in CLOCKS:
        raise Refusal("modbus", "clock", "be known", clock, ", ".join(CLOCKS))
    check_baud("modbus", baud)
    if not 1 <= station <= LARGEST_STATION:
        raise Refusal("modbus", "station", f"be 1 to {LARGEST_STATION}", station)
    errors = LineErrors(error_rate, seed)
    scene = load_scene(scene_name)
    warn_of_scene(scene)
    if clock == "realtime":
        session = real_time_session(scene, "first_answer")
    else:
        session = Session(scene, "lockstep", "first_answer")
    try:
        converter = Converter(session, watchdog)
        waits = clock != "realtime"
        with serial_port(baud, link) as port, Recorder(session.plant, kept, waits):
            at = f"{port.path}{f' ({link})' if link else ''}"
            print(f"modbus: scene {scene.name} ({len(scene.joints)} joints), station {station}")
            print(f"modbus: {at}, {baud} baud, clock {clock}", flush=True)
            if clock == "realtime":
                RealTimeService(port, converter, station, baud, errors).serve()
            else:
                line = ModbusLine(converter, station, clock, baud, errors)
                serve(port, line, converter, baud)
    finally:
        session.close()
    return 0


def print_registers(scene_name: str) -> int:
    """Print the table of registers of a scene.

    Raises:
        Refusal: the scene is refused.
    """
    for one in blocks(load_scene(scene_name)):
        last = one.address + one.count - 1
        where = f"{one.address}" if one.count == 1 else f"{one.address} to {last}"
        access = "rw" if one.writable else "r"
        per = f" [{one.per} per joint]" if one.per else ""
        print(f"{where:<16} {access:<3} {one.kind:<8} {one.name}{per}, {one.unit}".rstrip(", "))
    return 0
