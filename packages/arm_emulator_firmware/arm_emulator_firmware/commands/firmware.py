"""Run unmodified firmware of a Cortex-M4F in the loop with a machine."""

import contextlib
import os
import pty
import socket
import sys
import termios
import time
import tty
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.extension.base import KEEP_NOTHING, Refusal, find_scene, print_warnings
from arm_emulator.extension.commands import (
    Keep,
    PageAt,
    SceneName,
    Seconds,
    TargetFile,
    When,
    command,
    count_ticks,
    end_at_ctrl_c,
    output,
    report_run,
    serve_controls,
    wait_for_ctrl_c,
)
from arm_emulator.extension.machine import Diverged, explain_divergence, load_scene
from arm_emulator.extension.runs import (
    Breakpoint,
    Recorder,
    TableRun,
    check_targets,
    compute_tool_error,
    find_last_target,
    find_missed_target,
    load_target_table,
)
from arm_emulator_firmware.board import Board, load_board
from arm_emulator_firmware.elf_image import ElfImage
from arm_emulator_firmware.microcontroller import FirmwareEnd, Microcontroller

_WHERE = ("stdout", "pty", "none")


@command(
    keys=(
        "as `run`; `failed`, `instructions_per_period`, `awake`, `faults`, `resets`, `first_fault`"
    ),
)
def simulate_firmware(
    board: Path,
    firmware: Path,
    /,
    *,
    scene: SceneName = "three_axis",
    targets: TargetFile = None,
    seconds: Seconds = None,
    gdb: Annotated[int | None, Parameter(metavar="PORT")] = None,
    stop_when: When = None,
    uart: Annotated[list[str] | None, Parameter(metavar="NAME=WHERE ...")] = None,
    page: PageAt = None,
    outputs: Keep = KEEP_NOTHING,
) -> int:
    """Run unmodified firmware of a microcontroller in the loop with a machine.

    The exit code is 1 where a joint is not within 0.01 rad of the last row of the targets.

    Args:
        board: wiring of the registers (YAML).
        firmware: ELF file.
        gdb: port on 127.0.0.1 at which to wait for gdb.
        stop_when: condition at which gdb halts the firmware, and with it the machine.
        uart: a serial line of the board: stdout, pty or none (default: the first to stdout).
    """
    outputs.check_options("firmware")
    machine = load_scene(find_scene(scene))
    print_warnings(*machine.warnings)
    wiring = load_board(board, machine.joint_names)
    check = partial(check_targets, machine)
    table = None if targets is None else load_target_table(targets, machine.joint_names, check)
    if seconds is None:
        seconds = (table.seconds if table else None) or 10.0
    ticks = count_ticks(seconds, machine)
    if gdb is not None and not 0 < gdb < 65536:
        raise Refusal("firmware", "--gdb", "be a port from 1 to 65535", gdb)
    if stop_when is not None and gdb is None:
        raise Refusal("firmware", "--stop-when", "come with --gdb, which halts there", "none")
    with contextlib.ExitStack() as open_:
        lines = open_.enter_context(_open_lines(wiring, uart or ()))
        chip = Microcontroller(wiring, ElfImage(firmware), machine, lines)
        table_run = TableRun(machine, table, chip)
        open_.enter_context(Recorder(table_run.session.plant, outputs, waits=True, stays=True))
        if stop_when is not None:
            stops = Breakpoint(table_run.session.plant, stop_when, "firmware: --stop-when")
            open_.callback(stops.close)
            chip.break_at(stops.stop)
        server = open_.enter_context(
            serve_controls(table_run.session.plant, page, steps=True, waits=True)
        )
        with end_at_ctrl_c():
            if gdb is not None:
                _wait_for_gdb(chip, gdb, firmware)
            started = time.perf_counter()
            try:
                server.advance_ticks(table_run.advance, ticks)
            except (Diverged, FirmwareEnd) as fault:
                print(explain_divergence(fault), file=sys.stderr)
                output.add_facts({"scene": machine.name, "failed": explain_divergence(fault)})
                return 1
        wall = time.perf_counter() - started
        target = None if table is None else find_last_target(machine, table, ticks)
        off = None if target is None else compute_tool_error(table_run.session, target)
        report_run(table_run.session, ticks, wall, off)
        missed = "" if target is None else find_missed_target(table_run.session, target)
        figures = chip.figures
        awake = 1.0 - figures.asleep / figures.cycles if figures.cycles else 0.0
        each = figures.instructions / ticks
        output.add_facts({
            "failed": None, "instructions_per_period": each, "awake": awake,
            "faults": figures.faults, "resets": figures.resets,
            "first_fault": chip.fault if figures.faults else None,
        })  # fmt: skip
        happened = {"faults": figures.faults, "resets": figures.resets}
        more = "".join(f", {count} {event}" for event, count in happened.items() if count)
        print(
            f"microcontroller   {each:.0f} instructions per servo period, {awake:.1%} awake{more}"
        )
        if figures.faults:
            print(f"first fault       {chip.fault}")
        if page is not None:
            wait_for_ctrl_c()
        return output.report_miss("firmware", missed)


def _wait_for_gdb(chip: Microcontroller, port: int, elf: Path) -> None:
    with socket.socket() as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind(("127.0.0.1", port))
        except OSError as error:
            raise Refusal("firmware", f"port {port}", "be free", error.strerror) from None
        listening.listen(1)
        print(f"waiting for gdb: gdb-multiarch {elf} -ex 'target remote :{port}'", file=sys.stderr)
        chip.wait_for_debugger(listening)


@contextlib.contextmanager
def _open_lines(board: Board, reported: Sequence[str]) -> Iterator[dict[str, tuple[int, int]]]:
    """Yield file descriptors to write to and read from for serial lines, by their names."""
    names = board.uarts
    outputs = {name: "stdout" if place == 0 else "none" for place, name in enumerate(names)}
    for text in reported:
        name, _, where = text.partition("=")
        if not where and len(names) == 1:
            name, where = names[0], name
        if name not in names:
            valid = ", ".join(names) or "none: the board has no uart"
            raise Refusal("firmware", "--uart", "name a serial line of the board", text, valid)
        if where not in _WHERE:
            valid = ", ".join(f"{name}={destination}" for destination in _WHERE)
            raise Refusal("firmware", "--uart", "state where the line goes", text, valid)
        outputs[name] = where
    sys.stdout.flush()
    with contextlib.ExitStack() as open_:
        lines = {}
        for name, where in outputs.items():
            if where == "stdout":
                lines[name] = (1, -1)
            elif where == "pty":
                lines[name] = (open_.enter_context(_open_pty(name)),) * 2
        yield lines


@contextlib.contextmanager
def _open_pty(name: str) -> Iterator[int]:
    ours, theirs = pty.openpty()
    try:
        tty.setraw(theirs, termios.TCSANOW)
        os.set_blocking(ours, False)
        print(f"{name}: {os.ttyname(theirs)}", file=sys.stderr)
        yield ours
    finally:
        os.close(ours)
        os.close(theirs)
