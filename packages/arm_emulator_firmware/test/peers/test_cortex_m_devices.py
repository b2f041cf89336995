"""Counters, converters, bridges, serial lines and timers of an emulated microcontroller."""

import socket
from pathlib import Path

import numpy as np
import pytest
import yaml
from cortex_m import (
    EXAMPLE,
    SCENE,
    TINY,
    chip_of,
    cross,
    host_cc,
    random_table,
    run_firmware,
    tiny,
    words_of,
    write_board,
)
from visits import states

from arm_emulator.base.io.config_files import find_scene
from arm_emulator.cli.commands.servo_header import write_header
from arm_emulator.core import BOUNDARY
from arm_emulator.machine.session.firmware import Firmware
from arm_emulator.runs.gains import load_gains
from arm_emulator.runs.table_run import TableRun
from arm_emulator.runs.target_table import TargetTable
from arm_emulator.servo.c import FOLDER as SERVO
from arm_emulator.toolchain.flags import C_FLAGS
from arm_emulator_firmware.board import load_board
from arm_emulator_firmware.elf_image import ElfImage
from arm_emulator_firmware.microcontroller import FirmwareEnd, Microcontroller

# Devices

FLOATS = {
    "boot": 0.0001,
    "adc": {
        "ADC": {
            "status": 0x40000200,
            "flag": 0,
            "interrupt": 18,
            "clear": "one",
            "channels": {
                name: {"at": 0x40000210 + 4 * k, "holds": "float"}
                for k, name in enumerate(SCENE.joint_names)
            },
        }
    },
    "encoders": {
        name: {"at": 0x40000000 + 4 * k, "bits": 32} for k, name in enumerate(SCENE.joint_names)
    },
    "targets": {
        "count": 0x40000300,
        "joints": {name: 0x40000304 + 4 * k for k, name in enumerate(SCENE.joint_names)},
    },
}


def test_ideal_converters_give_the_motion_of_the_template(tmp_path: Path) -> None:
    """The template of your_firmware.md, its FLOAT build, against the servo on a chip."""
    servo = load_gains(find_scene("three_axis")).servo
    (tmp_path / "servo_joints.h").write_text(write_header("three_axis", SCENE.joint_names, servo))
    objects = []
    for source in (SERVO / "template/mine.c", SERVO / "servo.c"):
        objects.append(str(tmp_path / f"{source.stem}.o"))
        folders = [f"-I{path}" for path in (SERVO, BOUNDARY, tmp_path)]
        host_cc(*C_FLAGS, "-DSERVO_FLOAT", *folders, "-c", str(source), "-o", objects[-1])
    host_cc("-shared", *objects, "-o", str(tmp_path / "mine.so"))
    (tmp_path / "main.c").write_text(
        TINY
        + """
#include "servo.h"
#include "servo_joints.h"
#define NUMBER(at) (*(volatile float*)(at))
static servo_state states[SERVO_JOINTS];
static servo arm = {.joints = SERVO_JOINTS, .joint = servo_joints, .state = states,
                    .watchdog = {.hold_after = SERVO_HOLD_AFTER, .cut_after = SERVO_CUT_AFTER},
                    .motion_period = SERVO_MOTION_PERIOD};
static int64_t now;
static float voltage[SERVO_JOINTS];
void ADC_Handler(void) {
  int64_t counts[SERVO_JOINTS];
  float current[SERVO_JOINTS], q[SERVO_JOINTS];
  REGISTER(0x40000200) = 1;
  for (int j = 0; j < SERVO_JOINTS; ++j) {
    counts[j] = (int32_t)REGISTER(0x40000000 + 4 * j);
    current[j] = NUMBER(0x40000210 + 4 * j);
    q[j] = NUMBER(0x40000304 + 4 * j);
  }
  servo_measure(&arm, now, counts, current, voltage, 0);
  servo_aim(&arm, q, 0, 0);
  servo_command(&arm, 1, voltage);
  for (int j = 0; j < SERVO_JOINTS; ++j) NUMBER(0x40000100 + 4 * j) = voltage[j];
  now += SERVO_PERIOD;
}
int main(void) {
  servo_reset(&arm);
  ISER(18) = 1u << 18;
  for (;;) sleep();
}
"""
    )
    sources = [EXAMPLE / "startup.c", tmp_path / "main.c", SERVO / "servo.c"]
    elf = cross(tmp_path / "ideal.elf", *map(str, sources), "-DSERVO_FLOAT")
    table = random_table(np.random.default_rng(10), SCENE, 200)
    expected = states(TableRun(SCENE, table, Firmware(tmp_path / "mine.so")), 300)
    chip = chip_of(SCENE, elf, write_board(tmp_path, **FLOATS))
    assert states(TableRun(SCENE, table, chip), 300) == expected, "the machine at each tick"


COUNTING = """
void ADC_Handler(void) {
  REGISTER(0x40000200) = 0;
  for (int j = 0; j < 3; ++j) put_word(REGISTER(0x40000000 + 4 * j));
  for (int j = 0; j < 3; ++j) put_word(REGISTER(0x40000210 + 4 * j));
}
int main(void) {
  for (int j = 0; j < 3; ++j) REGISTER(0x40000000 + 4 * j) = FIRST;
  DRIVE
  ISER(18) = 1u << 18;
  REGISTER(0x40000204) = 1u << 5;
  for (;;) __asm__ volatile(SLEEP);
}
"""


@pytest.mark.parametrize("seed", range(3))
def test_counters_converters_and_bridges_are_as_documented(seed: int, tmp_path: Path) -> None:
    """Widths, wraps, scales, kinds of bridges, enable pins: by the formulas of the page."""
    rng = np.random.default_rng([11, seed])
    names, supply = SCENE.joint_names, SCENE.supply_voltage
    bits, adc_bits = rng.integers(8, 33, 3).tolist(), rng.integers(6, 16, 3).tolist()
    scale = [float(rng.choice([-1, 1]) * 2**b / rng.uniform(2, 40)) for b in adc_bits]
    offset = [float(rng.integers(0, 2**b)) for b in adc_bits]
    top, first = int(rng.integers(50, 5000)), int(rng.integers(0, 256))
    compare = rng.integers(0, top + 20, 3).tolist()
    minus, edge = int(rng.integers(0, top)), bool(rng.integers(2))
    disabled = int(rng.integers(3))
    aligned = {"reload": 0x40000120, "aligned": "edge" if edge else "center"}
    kinds: list[dict[str, object]] = [
        {"kind": "bipolar"},
        {"kind": "unipolar", "direction": 0x40000134, "direction_bit": 9},
        {"kind": "pair", "minus": 0x40000130},
    ]
    board = write_board(
        tmp_path,
        boot=0.0001,
        encoders={n: {"at": 0x40000000 + 4 * k, "bits": bits[k]} for k, n in enumerate(names)},
        adc={
            "ADC": {
                **{"status": 0x40000200, "flag": 3, "control": 0x40000204, "enable": 5},
                "interrupt": 18,
                "channels": {
                    n: {
                        "at": 0x40000210 + 4 * k,
                        "bits": adc_bits[k],
                        "counts_per_ampere": scale[k],
                        "offset": offset[k],
                    }
                    for k, n in enumerate(names)
                },
            }
        },
        pwm={
            n: {**kinds[k], **aligned, "compare": 0x40000100 + 4 * k} for k, n in enumerate(names)
        },
        ports={"P": {"output": 0x40000140, "set_reset": 0x40000144}},
        pins={
            n: {"is": "enable", "at": 0x40000140, "bit": k, "joint": n, "active": "low"}
            for k, n in enumerate(names)
        },
    )
    drive = [f"REGISTER({0x40000100 + 4 * k}) = {compare[k]};" for k in range(3)]
    drive += [f"REGISTER(0x40000130) = {minus};", f"REGISTER(0x40000120) = {top};"]
    drive += [f"REGISTER(0x40000134) = {0x200 * (seed % 2)};"]
    drive += [f"REGISTER(0x40000144) = {1 << disabled};"]
    text = COUNTING.replace("FIRST", str(first)).replace("DRIVE", " ".join(drive))
    elf = tiny(tmp_path, text.replace("SLEEP", rng.choice(['"wfi"', '"wfe"'])))
    ticks = 30
    heard = np.array(words_of(run_firmware(board, elf, ticks)), np.int64).reshape(ticks, 6)
    duty = [min(count / (top + edge), 1.0) for count in (*compare, minus)]
    sign = -1 if seed % 2 else 1
    voltage = [supply * (2 * duty[0] - 1), sign * supply * duty[1], supply * (duty[2] - duty[3])]
    voltage[disabled] = 0.0
    loop = TableRun(SCENE, None, Firmware(library_that_drives(voltage, disabled, tmp_path)))
    begun: list[int] = []
    for tick in range(ticks):
        measured = loop.session.measured
        counts = [int(count) for count in measured.encoder_counts]
        begun = begun or counts
        expected = [
            (first + count - zero) % 2**b
            for count, zero, b in zip(counts, begun, bits, strict=True)
        ]
        expected += [
            int(min(max(np.floor(value * s + o + 0.5), 0), 2**b - 1))
            for value, s, o, b in zip(measured.current, scale, offset, adc_bits, strict=True)
        ]
        assert heard[tick].tolist() == expected, f"registers at tick {tick}"
        loop.advance(1)


def library_that_drives(voltage: list[float], disabled: int, folder: Path) -> Path:
    """Return a library that gives voltages, and leaves the drive of a joint off."""
    (folder / "drives.c").write_text(
        f"""
#include "firmware.h"
static void step(const firmware_input* in, firmware_output* out) {{
  static const double voltage[] = {{{", ".join(map(repr, voltage))}}};
  (void)in;
  for (int j = 0; j < 3; ++j) out->joint[j].value = voltage[j];
  out->joint[{disabled}].enable = 0;
}}
const firmware* arm_firmware(void) {{
  static const firmware mine = {{FIRMWARE_VERSION, 0, 0, step}};
  return &mine;
}}
"""
    )
    library = folder / "drives.so"
    host_cc(*C_FLAGS, f"-I{BOUNDARY}", str(folder / "drives.c"), "-o", str(library))
    return library


ECHO = """
#define RING 256
static volatile uint8_t ring[RING];
static volatile uint32_t came, gone;
void USART2_Handler(void) {
  if (UART_SR & 0x20) ring[came++ % RING] = UART_DR;
  if (came != gone && (UART_SR & 0x80)) UART_DR = ring[gone++ % RING];
  UART_CR = came != gone ? 0xa0 : 0x20;
}
int main(void) {
  UART_CR = 0x20;
  ISER(38) = 1u << 38 % 32;
  for (;;) sleep();
}
"""


def with_vector(folder: Path, number: int, handler: str) -> Path:
    """Write start-up code with one more handler."""
    text = (EXAMPLE / "startup.c").read_text()
    more = f"[16 + {number}] = {handler},\n    [16 + 18] = ADC_Handler,"
    text = text.replace("[16 + 18] = ADC_Handler,", more)
    text = text.replace("typedef void", f"void {handler}(void);\ntypedef void", 1)
    file = folder / "startup.c"
    file.write_text(text)
    return file


def line_run(
    folder: Path, text: str, table: TargetTable | None, sent: bytes, ticks: int, **line: object
) -> bytes:
    """Run firmware with a serial line to which some bytes are sent first; return what it states."""
    startup = with_vector(folder, 38, "USART2_Handler")
    (folder / "echo.c").write_text(TINY + text)
    elf = cross(folder / "echo.elf", str(startup), str(folder / "echo.c"))
    board = yaml.safe_load(write_board(folder, boot=0.001).read_text())
    board["uart"]["line"].update(line)
    (folder / "board.yaml").write_text(yaml.safe_dump(board))
    ours, theirs = socket.socketpair()
    with ours, theirs:
        theirs.setblocking(False)
        ours.sendall(sent)
        lines = {"line": (theirs.fileno(), theirs.fileno())}
        read = load_board(folder / "board.yaml", SCENE.joint_names)
        chip = Microcontroller(read, ElfImage(elf), SCENE, lines)
        TableRun(SCENE, table, chip).advance(ticks)
        theirs.close()
        heard = b""
        while piece := ours.recv(4096):
            heard += piece
    return heard


def test_a_serial_line_brings_and_takes_bytes_at_its_pace(tmp_path: Path) -> None:
    rng = np.random.default_rng(13)
    sent = rng.integers(0, 256, 200).astype(np.uint8).tobytes()
    assert line_run(tmp_path, ECHO, None, sent, 10) == sent, "the echo of what was sent"
    slow = line_run(tmp_path, ECHO, None, sent, 20, baud=57600)
    # A byte arrives after its time, and its echo is under way at once: one byte each 10/57600 s.
    assert slow == sent[: int(0.020 * 5760)], "the echo of what has come in 20 ms"


def test_targets_arrive_on_a_serial_line(tmp_path: Path) -> None:
    table = random_table(np.random.default_rng(14), SCENE, 20)
    heard = line_run(tmp_path, ECHO, table, b"", 30, targets=True)
    rows = table.q if table.t[0] == 0.0 else np.vstack([SCENE.start, table.q])
    expected = b""
    for row in rows:
        numbers = row.astype("<f4").tobytes()
        expected += b"\xa5\x5a" + numbers + bytes([sum(numbers) % 256])
    assert heard == expected, "frames of the table's rows"


@pytest.mark.parametrize("free", [False, True])
def test_systick_and_the_cycle_counter_agree(free: bool, tmp_path: Path) -> None:
    """A sleeping processor wakes in the cycle of the event, with any duration of instructions."""
    rng = np.random.default_rng([15, free])
    load = int(rng.integers(10_000, 40_000))
    text = f"""
void SysTick_Handler(void) {{ put_word(REGISTER(0xe0001004)); }}
int main(void) {{
  SYSTICK_LOAD = {load};
  REGISTER(0xe000e018) = 0;
  SYSTICK_CTRL = 7;
  for (;;) sleep();
}}
"""
    board = write_board(
        tmp_path,
        cycles_per_instruction=0 if free else 1,
        cycles_per_branch=0 if free else float(rng.uniform(0, 3)),
    )
    if free:  # a line that is free at once: nobody waits for it in a loop
        text = text.replace(
            "put_word(REGISTER(0xe0001004));", "UART_DR = REGISTER(0xe0001004) >> 4;"
        )
    heard = run_firmware(board, tiny(tmp_path, text), 8)
    if free:
        times = np.frombuffer(heard, np.uint8)
        expected = [(k * (load + 1) >> 4) % 256 for k in range(1, len(times) + 1)]
        assert times.tolist() == expected, "the cycle counter at each tick"
    else:
        times = np.array(words_of(heard))
        assert (np.diff(times) == load + 1).all(), "cycles from tick to tick"
    assert len(times) == 8 * 168_000 // (load + 1), "ticks in 8 ms"


def test_firmware_that_waits_where_no_time_passes_ends_in_a_line(tmp_path: Path) -> None:
    text = "int main(void) { SYSTICK_LOAD = 99; SYSTICK_CTRL = 5;"
    text += " while (!(SYSTICK_CTRL & 1u << 16)) continue; for (;;) sleep(); }"
    board = write_board(tmp_path, cycles_per_instruction=0, cycles_per_branch=0)
    elf = tiny(tmp_path, text)
    with pytest.raises(FirmwareEnd, match=r"200 million instructions without sleep.* in main"):
        run_firmware(board, elf)
    with pytest.raises(FirmwareEnd) as end:
        run_firmware(write_board(tmp_path, memory={"flash": {"at": 0x08000000, "size": 1 << 20},
                     "ram": {"at": 0x20000000, "size": 1 << 16}}), elf)  # fmt: skip
    assert "stack" in str(end.value) or "where nothing is" in str(end.value), "half of its RAM"
