"""Firmware for the tests of microcontrollers: boards, small programs, how they are run."""

import os
import shutil
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("unicorn", reason="no unicorn")
pytest.importorskip("elftools", reason="no pyelftools")
if shutil.which("arm-none-eabi-gcc") is None:
    pytest.skip("no arm-none-eabi-gcc", allow_module_level=True)

from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator.runs.table_run import TableRun
from arm_emulator.runs.target_table import TargetTable
from arm_emulator.servo.c import FOLDER as SERVO
from arm_emulator.toolchain.compiler_command import find_compiler
from arm_emulator_firmware import FOLDER
from arm_emulator_firmware.board import load_board
from arm_emulator_firmware.elf_image import ElfImage
from arm_emulator_firmware.microcontroller import Microcontroller

EXAMPLE = FOLDER / "examples/stm32f4_like"
CROSS = (
    "arm-none-eabi-gcc -mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16 -std=gnu99 -g"
    " -ffp-contract=off -ffreestanding -fno-strict-aliasing -Wall -Wextra -Werror"
    " -nostartfiles --specs=nosys.specs -Wl,--no-warn-rwx-segments"
).split()
SCENE = load_scene("three_axis")

# Building blocks of small programs: registers, a serial line, an optional handler.
TINY = """
#include <stdint.h>
#define REGISTER(at) (*(volatile uint32_t*)(at))
#define UART_SR REGISTER(0x40004400)
#define UART_DR REGISTER(0x40004404)
#define UART_CR REGISTER(0x4000440c)
#define ISER(n) REGISTER(0xe000e100 + 4 * ((n) / 32))
#define ISPR(n) REGISTER(0xe000e200 + 4 * ((n) / 32))
#define PRIORITY(n) (*(volatile uint8_t*)(0xe000e400 + (n)))
#define SHPR(n) (*(volatile uint8_t*)(0xe000ed14 + (n)))
#define ICSR REGISTER(0xe000ed04)
#define SYSTICK_CTRL REGISTER(0xe000e010)
#define SYSTICK_LOAD REGISTER(0xe000e014)
static inline void put(uint8_t byte) {
  while (!(UART_SR & 0x80)) continue;
  UART_DR = byte;
}
static inline void put_word(uint32_t word) {
  for (int k = 0; k < 4; ++k) put(word >> 8 * k);
}
static inline void sleep(void) { __asm__ volatile("wfi"); }
"""


def cross(out: Path, *words: str, level: str = "-O2") -> Path:
    """Build firmware, and fail on any warning."""
    command = [*CROSS, level, f"-I{EXAMPLE}", f"-I{SERVO}", f"-I{out.parent}", *words]
    command += ["-T", str(EXAMPLE / "link.ld"), "-o", str(out), "-lc", "-lgcc"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), f"the cross compiler: {done.stderr}"
    return out


def tiny(folder: Path, text: str, level: str = "-O2") -> Path:
    """Build a small program."""
    source = folder / "tiny.c"
    source.write_text(TINY + text)
    return cross(folder / "tiny.elf", str(EXAMPLE / "startup.c"), str(source), level=level)


def write_board(folder: Path, **more: object) -> Path:
    """Write a board for three_axis: floats at the converters, a serial line that is fast."""
    names = SCENE.joint_names
    board: dict[str, object] = {
        "clock": 168e6,
        "interrupts": 82,
        "memory": {
            "flash": {"at": 0x08000000, "size": 1 << 20},
            "ram": {"at": 0x20000000, "size": 1 << 17},
        },
        "registers": {"all": {"at": 0x40000000, "size": 0x8000}},
        "encoders": {name: {"at": 0x40000000 + 4 * k, "bits": 16} for k, name in enumerate(names)},
        "pwm": {
            name: {"kind": "float", "compare": 0x40000100 + 4 * k} for k, name in enumerate(names)
        },
        "uart": {
            "line": {
                "status": 0x40004400,
                "data": 0x40004404,
                "control": 0x4000440C,
                "interrupt": 38,
                "baud": 1e7,
            }
        },
        **more,
    }
    file = folder / "board.yaml"
    file.write_text(yaml.safe_dump(board))
    return file


def run_firmware(board: Path, elf: Path, ticks: int = 3) -> bytes:
    """Run firmware with three_axis, and return what it has written to its serial line."""
    ours, theirs = os.pipe()
    heard = bytearray()

    def listen() -> None:
        while piece := os.read(ours, 4096):
            heard.extend(piece)

    listener = threading.Thread(target=listen)
    listener.start()
    try:
        lines = {"line": (theirs, -1)}
        read = load_board(board, SCENE.joint_names)
        table_run = TableRun(SCENE, None, Microcontroller(read, ElfImage(elf), SCENE, lines))
        table_run.advance(ticks)
    finally:
        os.close(theirs)
        listener.join()
        os.close(ours)
    return bytes(heard)


def words_of(heard: bytes) -> list[int]:
    return np.frombuffer(heard, "<u4").tolist()


def random_table(rng: np.random.Generator, scene: Scene, ticks: int) -> TargetTable:
    start = np.asarray(scene.start)
    t = np.sort(rng.choice(ticks, 4, replace=False)) * scene.servo_period
    return TargetTable(t, start + rng.uniform(-0.1, 0.1, (4, len(start))))


def chip_of(scene: Scene, elf: Path, board: Path = EXAMPLE / "board.yaml") -> Microcontroller:
    return Microcontroller(load_board(board, scene.joint_names), ElfImage(elf), scene)


def host_cc(*words: str) -> None:
    done = subprocess.run([*find_compiler(), *words], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), "exit code and words of the compiler"


def elf_of(at: int, content: bytes) -> bytes:
    """Return an ELF file for Arm that loads some bytes."""
    header = b"\x7fELF\x01\x01\x01" + bytes(9)
    for size, value in ((2, 2), (2, 40), (4, 1), (4, at), (4, 52), (4, 0), (4, 0)):
        header += value.to_bytes(size, "little")
    for value in (52, 32, 1, 40, 0, 0):
        header += value.to_bytes(2, "little")
    segment = (1, 84, at, at, len(content), len(content), 5, 4)
    return header + b"".join(value.to_bytes(4, "little") for value in segment) + content
