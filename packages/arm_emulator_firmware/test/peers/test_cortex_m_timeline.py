"""A chip with firmware in a timeline: any tick of its past and its forks, to the last bit."""

import os
from pathlib import Path

import numpy as np
import pytest
from cortex_m import EXAMPLE, SCENE, chip_of, cross, random_table, tiny, write_board
from visits import random_visits

from arm_emulator.base.io.config_files import find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.commands.servo_header import write_header
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.runs.gains import load_gains
from arm_emulator.runs.table_run import TableRun
from arm_emulator.runs.timeline import Timeline
from arm_emulator.servo.c import FOLDER as SERVO
from arm_emulator_firmware.board import load_board
from arm_emulator_firmware.elf_image import ElfImage
from arm_emulator_firmware.microcontroller import Microcontroller

# Firmware whose voltages follow from the whole state of a chip. This state has registers of the FPU
# across interrupts, the cycle counter within a line, both timers, and a counter that was set. It
# has bytes that wait on a serial line, code in RAM that it changes, masks, sleep, and a reset now
# and then.
RESTLESS = """
#define CYCCNT REGISTER(0xe0001004)
#define RESETS (*(volatile uint32_t*)0x2001f000)
#define CODE ((uint16_t*)0x20030000)
static volatile uint32_t mixed = 1, ticks, held;
static float share = 0.5f;
static void mix(uint32_t word) { mixed = (mixed ^ word) * 16777619u + RESETS; }
void SysTick_Handler(void) {
  mix(CYCCNT), mix(REGISTER(0xe000e018)), ++ticks;
  share = 0.75f * share + 0.25f * (float)(mixed >> 8) / 16777216.0f;
  if (mixed % 7 == 0) ISPR(18) = 1u << 18;
}
void ADC_Handler(void) { mix(ICSR), mix(held++); }
static uint32_t line(void) {
  uint32_t a, b;
  __asm__ volatile("nop\\n ldr %0, [%2]\\n eors %0, %0, #1\\n ldr %1, [%2]"
                   : "=&r"(a), "=r"(b) : "r"(0xe0001004) : "cc");
  return a * 31 + b;
}
int main(void) {
  PRIORITY(18) = 0x80, ISER(18) = 1u << 18;
  REGISTER(0x40000000) = 100 + RESETS;
  SYSTICK_LOAD = 30011, SYSTICK_CTRL = 7;
  for (;;) {
    mix(line()), mix(REGISTER(0x40000000)), mix(SYSTICK_CTRL);
    if (UART_SR & 0x20) mix(UART_DR);
    CODE[0] = (uint16_t)(0x2000 | (mixed & 0xff));  /* movs r0, # */
    CODE[1] = 0x4770;                               /* bx lr */
    __asm__ volatile("dsb\\n isb" ::: "memory");
    mix(((uint32_t(*)(void))0x20030001)());
    if (mixed & 32) __asm__ volatile("cpsid i");
    for (int k = 0; k < 3; ++k) {
      union { float f; uint32_t u; } word = {share + (float)k - 1.0f};
      REGISTER(0x40000100 + 4 * k) = word.u;
    }
    __asm__ volatile("cpsie i");
    if (mixed % 61 == 0) ++RESETS, REGISTER(0xe000ed0c) = 0x05fa0004;
    if (mixed & 4) sleep();
  }
}
"""
MEMORY = {
    "flash": {"at": 0x08000000, "size": 1 << 20},
    "ram": {"at": 0x20000000, "size": 1 << 17},
    "code_ram": {"at": 0x20030000, "size": 1 << 10},
}
LINE = {
    "status": 0x40004400,
    "data": 0x40004404,
    "control": 0x4000440C,
    "baud": 1e5,
    "targets": True,
}


def chip_with(folder: Path, text: str, **board: object) -> Microcontroller:
    elf = folder / "tiny.elf"
    if not elf.exists():
        tiny(folder, text)
    wiring = load_board(
        write_board(folder, memory=MEMORY, uart={"line": LINE}, **board), SCENE.joint_names
    )
    return Microcontroller(wiring, ElfImage(elf), SCENE)


@pytest.mark.parametrize("preload", [False, True])
def test_any_tick_of_firmware_can_be_visited(preload: bool, tmp_path: Path) -> None:
    chips: list[Microcontroller] = []

    def fresh() -> TableRun:
        chips.append(chip_with(tmp_path, RESTLESS, preload=preload))
        return TableRun(SCENE, random_table(np.random.default_rng(5), SCENE, 100), chips[-1])

    random_visits(fresh, np.random.default_rng(6))
    figures = chips[1].figures
    assert figures.resets and figures.exceptions > 300 and figures.asleep, "all of it happened"


def test_the_example_can_be_visited(tmp_path: Path) -> None:
    ur5 = load_scene("ur5")
    servo = load_gains(find_scene("ur5")).servo
    (tmp_path / "servo_joints.h").write_text(write_header("ur5", ur5.joint_names, servo))
    sources = [str(EXAMPLE / f"{name}.c") for name in ("startup", "main", "control")]
    elf = cross(tmp_path / "it.elf", *sources, str(SERVO / "servo.c"), "-DSERVO_FLOAT")
    table = random_table(np.random.default_rng(1), ur5, 200)
    random_visits(lambda: TableRun(ur5, table, chip_of(ur5, elf)), np.random.default_rng(2))


def test_a_chip_with_a_wired_line_cannot_be_saved(tmp_path: Path) -> None:
    chip_with(tmp_path, RESTLESS)
    board = load_board(write_board(tmp_path, memory=MEMORY), SCENE.joint_names)
    out, line = os.pipe()
    chip = Microcontroller(board, ElfImage(tmp_path / "tiny.elf"), SCENE, {"line": (line, -1)})
    with pytest.raises(Refusal, match="the chip must be one that can be saved"):
        Timeline(TableRun(SCENE, None, chip))
    os.close(line)
    os.close(out)
