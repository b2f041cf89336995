"""Unmodified firmware of a Cortex-M4F in the loop with a machine, free and in a debugger."""

from __future__ import annotations

import shutil
import socket
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cortex_m import EXAMPLE, chip_of, cross, host_cc, random_table
from visits import states

from arm_emulator import Breakpoint, Scene, load_gains, load_scene
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.cli.commands.servo_header import write_header
from arm_emulator.core import BOUNDARY
from arm_emulator.machine.session.firmware import Firmware
from arm_emulator.runs.table_run import TableRun
from arm_emulator.runs.target_table import TargetTable
from arm_emulator.servo.c import FOLDER as SERVO
from arm_emulator.toolchain.flags import C_FLAGS
from arm_emulator_firmware.microcontroller import FirmwareEnd, Microcontroller

# The example, and the same code as a library


@pytest.fixture(scope="module")
def ur5() -> Scene:
    return load_scene("ur5")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory, ur5: Scene) -> Callable[..., Path]:
    folder = tmp_path_factory.mktemp("example")
    servo = load_gains(find_scene("ur5")).servo
    (folder / "servo_joints.h").write_text(write_header("ur5", ur5.joint_names, servo))

    def build(name: str, *flags: str, level: str = "-O2") -> Path:
        sources = [EXAMPLE / "startup.c", EXAMPLE / "main.c", EXAMPLE / "control.c"]
        words = [*map(str, sources), str(SERVO / "servo.c"), "-DSERVO_FLOAT", *flags]
        return cross(folder / name, *words, level=level)

    return build


def library_of_example(folder: Path, late: bool = False) -> Firmware:
    """The example's control code as a user's library, behind converters by the formulas of docs.

    What it computes counts from the period on in which it does, or from the next one on (`late`).
    """
    name = "late" if late else "host"
    (folder / f"{name}.c").write_text(
        f"enum {{ LATE = {int(late)} }};"
        + """
#include <math.h>
#include "firmware.h"
#include "control.h"
#include "servo_joints.h"
static const char* start(const firmware_machine* machine) {
  (void)machine;
  control_start();
  return 0;
}
static void step(const firmware_input* in, firmware_output* out) {
  int64_t encoder[SERVO_JOINTS];
  uint32_t adc[SERVO_JOINTS], compare[SERVO_JOINTS];
  float q[SERVO_JOINTS];
  for (int j = 0; j < SERVO_JOINTS; ++j) {
    encoder[j] = in->measured->joint[j].encoder;
    double counts = floor(in->measured->joint[j].current * (j < 3 ? 40 : 160) + 2048 + 0.5);
    adc[j] = (uint32_t)fmin(fmax(counts, 0), 4095);
    q[j] = (float)in->q_target[j];
  }
  static uint32_t before[SERVO_JOINTS];
  if (in->time == 0)
    for (int j = 0; j < SERVO_JOINTS; ++j) before[j] = 4200;
  control_step(encoder, adc, q, 1, compare);
  for (int j = 0; j < SERVO_JOINTS; ++j) {
    out->joint[j].value = 48 * (2 * ((LATE ? before[j] : compare[j]) / 8400.0) - 1);
    before[j] = compare[j];
  }
}
const firmware* arm_firmware(void) {
  static const firmware mine = {FIRMWARE_VERSION, 0, start, step};
  return &mine;
}
"""
    )
    folders = [f"-I{path}" for path in (SERVO, BOUNDARY, EXAMPLE, folder)]
    objects = []
    for source in (folder / f"{name}.c", EXAMPLE / "control.c", SERVO / "servo.c"):
        objects.append(str(folder / f"{source.stem}.o"))
        host_cc(*C_FLAGS, "-DSERVO_FLOAT", *folders, "-c", str(source), "-o", objects[-1])
    host_cc("-shared", *objects, "-lm", "-o", str(folder / f"{name}.so"))
    return Firmware(folder / f"{name}.so")


def test_firmware_moves_the_arm_as_the_same_code_in_a_library(
    built: Callable[..., Path], ur5: Scene
) -> None:
    """Other compilers, levels and processors, asleep or not, one motion to the last bit."""
    elf = built("asleep.elf")
    rng = np.random.default_rng(1)
    table = random_table(rng, ur5, 300)
    expected = states(TableRun(ur5, table, library_of_example(elf.parent)), 300)
    assert len({*expected}) == 300, "states of a machine that moves"
    for name, level in (("asleep.elf", "-O2"), ("small.elf", "-Os")):
        table_run = TableRun(ur5, table, chip_of(ur5, built(name, level=level)))
        assert states(table_run, 300) == expected, f"the machine at each tick with {level}"
    awake = TableRun(ur5, table, chip_of(ur5, built("awake.elf", "-DAWAKE")))
    assert states(awake, 100) == expected[:100], "the machine at each tick, never asleep"


def test_with_preload_voltages_come_a_period_later(
    built: Callable[..., Path], ur5: Scene, tmp_path: Path
) -> None:
    elf = built("asleep.elf")
    board = tmp_path / "board.yaml"
    board.write_text((EXAMPLE / "board.yaml").read_text() + "preload: true\n")
    table = random_table(np.random.default_rng(12), ur5, 100)
    late = states(TableRun(ur5, table, library_of_example(elf.parent, late=True)), 100)
    assert states(TableRun(ur5, table, chip_of(ur5, elf, board)), 100) == late, "each tick"


def test_ten_runs_are_equal(built: Callable[..., Path], ur5: Scene) -> None:
    """To the last bit of the machine, and to the last instruction of the processor."""
    elf = built("asleep.elf")
    table = random_table(np.random.default_rng(2), ur5, 100)
    outcomes = set()
    for _ in range(10):
        chip = chip_of(ur5, elf)
        table_run = TableRun(ur5, table, chip)
        table_run.advance(200)
        figures = chip.figures
        outcomes.add(
            (table_run.session.plant.save(), figures.instructions, figures.cycles, figures.asleep)
        )
    assert len(outcomes) == 1, "states, instructions and cycles of ten runs"


def test_two_chips_are_independent(built: Callable[..., Path], ur5: Scene) -> None:
    elf = built("asleep.elf")
    table = random_table(np.random.default_rng(3), ur5, 50)
    alone = states(TableRun(ur5, table, chip_of(ur5, elf)), 60)
    first, second = (TableRun(ur5, table, chip_of(ur5, elf)) for _ in range(2))
    for tick in range(60):
        first.advance(1)
        second.advance(1)
        assert first.session.plant.save() == second.session.plant.save() == alone[tick], tick


# Debugging


class Debugger:
    """gdb's end of its remote protocol."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=20.0)
        self._stream = self._socket.makefile("rb")

    def send(self, raw: bytes) -> None:
        self._socket.sendall(raw)

    def ask(self, text: bytes) -> bytes:
        self.send(b"$" + text + b"#%02x" % (sum(text) % 256))
        return self.hear()

    def hear(self) -> bytes:
        """Return the next packet."""
        while (character := self._stream.read(1)) != b"$":
            assert character, "an open connection"
        text = b""
        while (character := self._stream.read(1)) != b"#":
            text += character
        self._stream.read(2)
        return text

    def __enter__(self) -> Debugger:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()
        self._socket.close()


def record_states(
    chip: Microcontroller, scene: Scene, table: TargetTable | None, ticks: int
) -> list[tuple[bytes, int, int, int]]:
    """Go on tick by tick; return the machine's state and what the processor has done at each."""
    table_run, tick_states = TableRun(scene, table, chip), []
    for _ in range(ticks):
        table_run.advance(1)
        done = chip.figures
        tick_states.append(
            (table_run.session.plant.save(), done.instructions, done.asleep, done.exceptions)
        )
    return tick_states


def address_of(elf: Path, function: str) -> int:
    command = ["arm-none-eabi-nm", str(elf)]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    return next(int(line.split()[0], 16) for line in lines if line.split()[-1] == function) & ~1


def debugged(
    chip: Microcontroller, scene: Scene, table: TargetTable | None, ticks: int,
    debugger: Callable[[int], None],
) -> list[tuple[bytes, int, int, int]]:  # fmt: skip
    """Return the course of a run beside which a debugger works at a port."""
    failed: list[BaseException] = []
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen(1)
        port = listening.getsockname()[1]

        def work() -> None:
            try:
                debugger(port)
            except BaseException as error:
                failed.append(error)

        worker = threading.Thread(target=work)
        worker.start()
        chip.wait_for_debugger(listening)
    try:
        return record_states(chip, scene, table, ticks)
    finally:
        worker.join()
        assert not failed, failed


@pytest.mark.skipif(shutil.which("gdb-multiarch") is None, reason="no gdb-multiarch")
@pytest.mark.parametrize("kind", ["asleep", "awake"])
def test_halting_in_gdb_changes_no_bit(
    built: Callable[..., Path], ur5: Scene, kind: str, tmp_path: Path
) -> None:
    """Breakpoints at functions and at any instruction, single steps, long halts."""
    elf = built(f"{kind}.elf", *(["-DAWAKE"] if kind == "awake" else []))
    rng = np.random.default_rng(4)
    ticks = 30 if kind == "asleep" else 6
    table = random_table(rng, ur5, 20)
    free = record_states(chip_of(ur5, elf), ur5, table, ticks)
    lines = ["set pagination off", "break control_step", "continue", "print *encoder", "backtrace"]
    for _ in range(6):
        action = rng.choice(["stepi", "next", "continue", "middle"])
        if action == "stepi":
            lines.append(f"stepi {rng.integers(1, 60)}")
        elif action == "middle":
            lines += [f"tbreak *(servo_command+{4 * rng.integers(1, 12)})", "continue"]
        else:
            lines.append(str(action))
        lines += [
            "info registers",
            "print $d3",
            "x/8xw $sp",
            "x/4xw 0x40012000",
            "shell sleep 0.05",
        ]
    lines += ["delete", "detach"]
    script = tmp_path / "script"
    script.write_text("\n".join(lines) + "\n")
    printed = []

    def gdb(port: int) -> None:
        command = ["gdb-multiarch", "-nx", "-batch", str(elf)]
        command += ["-ex", f"target remote :{port}", "-x", str(script)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        printed.append(done.stdout + done.stderr)

    halted = debugged(chip_of(ur5, elf), ur5, table, ticks, gdb)
    assert "Breakpoint 1, control_step" in printed[0] and "ADC_Handler" in printed[0], printed[0]
    assert halted == free, f"the machine at each tick, debugged and free\n{printed[0]}"


def test_gdb_halts_where_a_condition_on_the_machine_begins_to_hold(
    built: Callable[..., Path], ur5: Scene
) -> None:
    """Firmware and machine stand together; the run goes on to the same bits."""
    elf, ticks = built("asleep.elf"), 40
    table = random_table(np.random.default_rng(6), ur5, 8)
    free = record_states(chip_of(ur5, elf), ur5, table, ticks)
    chip = chip_of(ur5, elf)
    run, tick_states, stops_at = TableRun(ur5, table, chip), [], []
    stops = Breakpoint(run.session.plant, "tick >= 17")
    chip.break_at(stops.stop)

    def work(port: int) -> None:
        with Debugger(port) as gdb:
            assert gdb.ask(b"c") == b"S05", "as at a breakpoint"
            stops_at.append((stops.tick, len(tick_states)))
            gdb.send(b"$D#44")

    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen(1)
        worker = threading.Thread(target=work, args=[listening.getsockname()[1]])
        worker.start()
        chip.wait_for_debugger(listening)
    for _ in range(ticks):
        run.advance(1)
        done = chip.figures
        tick_states.append(
            (run.session.plant.save(), done.instructions, done.asleep, done.exceptions)
        )
    worker.join()
    assert stops_at == [(17, 17)], "before the firmware saw tick 17"
    assert tick_states == free


def test_every_step_and_any_packet_of_a_debugger_change_no_bit(
    built: Callable[..., Path], ur5: Scene
) -> None:
    """Walking through a whole period, interrupts from the terminal, malformed packets."""
    elf = built("asleep.elf")
    rng = np.random.default_rng(5)
    table = random_table(rng, ur5, 8)
    free = record_states(chip_of(ur5, elf), ur5, table, 300)
    handler = address_of(elf, "ADC_Handler")

    def work(port: int) -> None:
        with Debugger(port) as gdb:
            assert gdb.ask(b"?") == b"S05", "why it stands"
            assert gdb.ask(b"Z0,%x,2" % handler) == b"OK", "a breakpoint"
            for _ in range(2):
                assert gdb.ask(b"c") == b"S05", "at a breakpoint"
            pc = handler
            for _ in range(6):
                assert gdb.ask(b"s") == b"S05", "after a step"
                before, pc = pc, int.from_bytes(bytes.fromhex(gdb.ask(b"p f").decode()), "little")
                assert pc - before in (2, 4), "bytes of one instruction at the handler's beginning"
            for _ in range(900):
                assert gdb.ask(b"s") == b"S05", "after a step"
            assert gdb.ask(b"z0,%x,2" % handler) == b"OK", "no breakpoint"
            for _ in range(60):
                size = int(rng.integers(0, 30))
                text = bytes(rng.choice([*b"?gpmqvHTZz012345,;:ae\x00\xff"], size).astype(np.uint8))
                gdb.ask(b"m" + text if text[:1] in b"MGPcsDkZzv" else text)
            gdb.send(b"$m20000000,4#00+++\x01\x02$#00")
            gdb.hear()
            for _ in range(3):
                gdb.send(b"$c#63\x03")
                assert gdb.hear() == b"S02", "halted by Ctrl-C"
            gdb.send(b"$c#63")

    assert debugged(chip_of(ur5, elf), ur5, table, 300, work) == free, "the machine at each tick"


def test_a_debugger_ends_a_run(built: Callable[..., Path], ur5: Scene) -> None:
    elf = built("asleep.elf")

    def kill(port: int) -> None:
        with Debugger(port) as gdb:
            gdb.send(b"$k#6b")

    with pytest.raises(FirmwareEnd, match=r"^asleep\.elf: ended by the debugger$"):
        debugged(chip_of(ur5, elf), ur5, None, 3, kill)
