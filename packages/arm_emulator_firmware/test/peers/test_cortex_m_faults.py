"""Faults, resets and the cycle counter of an emulated Cortex-M4F, by the rules of ARMv7-M."""

import os
import socket
import threading
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from cortex_m import EXAMPLE, SCENE, TINY, cross, run_firmware, tiny, words_of, write_board
from draws import some
from test_cortex_m import Debugger

from arm_emulator.runs.table_run import TableRun
from arm_emulator_firmware.board import load_board
from arm_emulator_firmware.commands.firmware import simulate_firmware
from arm_emulator_firmware.elf_image import ElfImage
from arm_emulator_firmware.microcontroller import FirmwareEnd, Microcontroller

HOLE = 0x30000000
# The instruction that makes the fault, the exception of its own, and the bit of CFSR.
FAULTS = {
    "read": ("ldr r4, [r3]", 5, 1 << 9 | 1 << 15),
    "write": ("strb r4, [r3]", 5, 1 << 9 | 1 << 15),
    "wide write": ("str.w r4, [r3, #0]", 5, 1 << 9 | 1 << 15),
    "flash": ("str r4, [r3]", 5, 1 << 9 | 1 << 15),
    "undefined": ("udf #7", 6, 1 << 16),
    "undefined long": ("udf.w #7", 6, 1 << 16),
}
SHCSR, CFSR, HFSR, BFAR = "0xe000ed24", "0xe000ed28", "0xe000ed2c", "0xe000ed38"
FORCED = 1 << 30
# Reports where it is, all of its frame and the status registers, clears these, and steps over.
HANDLERS = f"""
void handle(uint32_t* frame);
void handle(uint32_t* frame) {{
  uint32_t ipsr;
  __asm__ volatile("mrs %0, ipsr" : "=r"(ipsr));
  put_word(ipsr);
  for (int k = 0; k < 8; ++k) put_word(frame[k]);
  put_word(REGISTER({CFSR})), put_word(REGISTER({HFSR})), put_word(REGISTER({BFAR}));
  REGISTER({CFSR}) = REGISTER({CFSR}), REGISTER({HFSR}) = ~0u;
  put_word(REGISTER({CFSR}) | REGISTER({HFSR}));
  frame[6] += (*(uint16_t*)frame[6] >> 11) >= 0x1d ? 4 : 2;
}}
#define HANDLER(name) \\
  __attribute__((naked)) void name(void) {{ \\
    __asm__ volatile("tst lr, #4\\n ite eq\\n mrseq r0, msp\\n mrsne r0, psp\\n b handle"); }}
HANDLER(HardFault_Handler)
HANDLER(MemManage_Handler)
HANDLER(BusFault_Handler)
HANDLER(UsageFault_Handler)
"""


def with_handlers(folder: Path, text: str) -> Path:
    """Build firmware with vectors for the handlers of all faults."""
    startup = (EXAMPLE / "startup.c").read_text()
    names = ("MemManage", "BusFault", "UsageFault")
    more = "".join(f"OTHERWISE void {name}_Handler(void);\n" for name in names)
    entries = "".join(f"[{4 + k}] = {name}_Handler, " for k, name in enumerate(names))
    startup = startup.replace("typedef void (*handler)", f"{more}typedef void (*handler)")
    startup = startup.replace("[11] = SVC", f"{entries}[11] = SVC")
    (folder / "startup.c").write_text(startup)
    (folder / "tiny.c").write_text(text)
    sources = [str(folder / name) for name in ("startup.c", "tiny.c")]
    return cross(folder / "tiny.elf", *sources, level="-O1")


@pytest.mark.parametrize("kind", FAULTS)
@pytest.mark.parametrize("handling", ["disabled", "enabled", "masked"])
def test_a_fault_goes_to_its_handler_with_its_frame(
    kind: str, handling: str, tmp_path: Path
) -> None:
    """Or to that of hard faults: its own is not switched on, or masked. The firmware goes on."""
    rng = np.random.default_rng([3, *kind.encode(), *handling.encode()])
    instruction, exception, status = FAULTS[kind]
    at = 0x08000000 + 4 * int(rng.integers(1 << 17)) if kind == "flash" else HOLE
    at += 4 * int(rng.integers(100))
    values = rng.integers(0, 1 << 32, 6).tolist()  # r0, r1, r2, r12, lr, r4
    loads = "\\n ".join(
        f"ldr {name}, ={value}"
        for name, value in zip(("r0", "r1", "r2", "r12", "lr", "r4"), values, strict=True)
    )
    flags = int(rng.integers(16)) << 28
    switch = f"REGISTER({SHCSR}) = 7u << 16;" if handling != "disabled" else ""
    mask = "cpsid i\\n " if handling == "masked" else ""
    elf = with_handlers(
        tmp_path,
        f"""{TINY}{HANDLERS}
extern char culprit[];
int main(void) {{
  {switch}
  __asm__ volatile("{loads}\\n ldr r3, ={flags}\\n msr apsr_nzcvq, r3\\n ldr r3, ={at}\\n"
      "{mask}.global culprit\\n culprit: {instruction}\\n cpsie i\\n"
      ::: "r0", "r1", "r2", "r3", "r4", "r12", "lr", "cc", "memory");
  put_word((uint32_t)culprit);
  put_word(0x600d);
  for (;;) sleep();
}}
""",
    )
    reported = words_of(run_firmware(write_board(tmp_path), elf, 10))
    ipsr, *frame = reported[:9]
    cfsr, hfsr, bfar, after, culprit, good = reported[9:]
    assert good == 0x600D, "it goes on behind the instruction"
    assert ipsr == (exception if handling == "enabled" else 3), "the handler"
    assert frame[:6] == [*values[:3], at, values[3], values[4]], "r0 to r3, r12, lr"
    assert frame[6] == culprit & ~1, "pc"
    assert frame[7] & ~0x200 == flags | 1 << 24, "xpsr: flags, Thumb, thread mode"
    assert (cfsr, hfsr) == (status, 0 if handling == "enabled" else FORCED), "status"
    if exception == 5:
        assert bfar == at, "the address"
    assert after == 0, "status is cleared by ones"


def test_a_supervisor_call_that_is_masked_is_a_hard_fault(tmp_path: Path) -> None:
    elf = with_handlers(
        tmp_path,
        f"""{TINY}{HANDLERS}
extern char culprit[];
int main(void) {{
  __asm__ volatile("cpsid i\\n .global culprit\\n culprit: svc #3\\n cpsie i");
  put_word((uint32_t)culprit);
  for (;;) sleep();
}}
""",
    )
    reported = words_of(run_firmware(write_board(tmp_path), elf, 10))
    assert (reported[0], reported[7], reported[10]) == (3, reported[13] & ~1, FORCED), (
        "handler, pc, HFSR"
    )


@pytest.mark.parametrize(
    ("handler", "line"),
    [
        ("void HardFault_Handler(void) { *(volatile int*)0x30000004; }", "lock-up in the handler"),
        ('void HardFault_Handler(void) { __asm__("bkpt"); }', "a breakpoint instruction"),
        ("void HardFault_Handler(void) { for (;;) continue; }", "firmware.elf: read of"),
        ("void HardFault_Handler(void) { *(volatile int*)0x20001000 = 1; for (;;) continue; }",
         "firmware.elf: read of"),
    ],
)  # fmt: skip
def test_a_handler_that_fails_or_stands_still_ends_the_run(
    handler: str, line: str, tmp_path: Path
) -> None:
    text = f"{handler}\nint main(void) {{ (void)*(volatile int*){HOLE:#x}; for (;;) sleep(); }}"
    elf = tiny(tmp_path, text, "-O1").rename(tmp_path / "firmware.elf")
    with pytest.raises(FirmwareEnd) as end:
        run_firmware(write_board(tmp_path), elf, 10)
    assert line in str(end.value) and "\n" not in str(end.value), end.value
    if "lock-up" in line or "breakpoint" in line:
        assert "lock-up in the handler of read of" in str(end.value), "what came first"
        assert "in HardFault_Handler" in str(end.value), "where it ended"
    else:
        assert "in main" in str(end.value), "where it came from"


def test_the_command_counts_faults_and_resets(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    elf = tiny(
        tmp_path,
        f"""
void HardFault_Handler(void) {{ REGISTER(0xe000ed0c) = 0x05fa0004; }}
int main(void) {{
  if (REGISTER(0x2001f000)++ < 2) (void)REGISTER({HOLE:#x});
  for (;;) sleep();
}}
""",
    )
    board = write_board(tmp_path)
    done = simulate_firmware(board, elf, seconds=0.01)
    assert done == 0, "exit code"
    printed = capfd.readouterr().out
    assert "awake, 2 faults, 2 resets" in printed, printed
    assert (
        "first fault       read of an address where nothing is (0x30000000), pc 0x0800" in printed
    ), printed
    assert "in main" in printed, "the function"


def test_a_reset_begins_again_and_keeps_memory(tmp_path: Path) -> None:
    """From thread and handler mode; masks, interrupts, timers and devices are as at the start."""
    elf = tiny(
        tmp_path,
        """
#define BOOTS REGISTER(0x2001f000)
#define CYCCNT REGISTER(0xe0001004)
static uint32_t mask(void) {
  uint32_t all, one;
  __asm__ volatile("mrs %0, primask\\n mrs %1, basepri\\n orr %0, %0, %1\\n mrs %1, faultmask\\n"
      "orr %0, %0, %1\\n mrs %1, ipsr\\n orr %0, %0, %1\\n mrs %1, psp\\n orr %0, %0, %1"
      : "=&r"(all), "=&r"(one));
  return all;
}
static void reset(void) { REGISTER(0xe000ed0c) = 0x05fa0004; for (;;) continue; }
void SysTick_Handler(void) { reset(); }
static uint32_t data = 5;
int main(void) {
  UART_CR = 0;
  put_word(BOOTS), put_word(data), put_word(mask());
  put_word(ISER(38) | SYSTICK_CTRL | SHPR(7) | REGISTER(0x40000200) | REGISTER(0xe000ed08) << 8);
  put_word(CYCCNT);
  data = 6, BOOTS += 1, REGISTER(0x40000200) = 7, ISER(38) = 1u << 38 % 32, SHPR(7) = 0x20;
  while (!(UART_SR & 0x40)) continue;  /* what is under way in the line would be lost */
  if (BOOTS == 1) {
    __asm__ volatile("msr psp, %0\\n msr basepri, %0\\n cpsid i" ::"r"(0x40));
    reset();
  }
  if (BOOTS == 2) { SYSTICK_LOAD = 500, SYSTICK_CTRL = 7; for (;;) continue; }
  for (;;) sleep();
}
""",
    )
    reported = np.reshape(words_of(run_firmware(write_board(tmp_path), elf, 10)), (-1, 5))
    assert reported[:, 0].tolist() == [0, 1, 2], "memory that nobody clears is kept"
    assert (reported[:, 1] == 5).all(), "start-up code runs again"
    assert not reported[:, 2].any(), "no masks, no handler, no process stack"
    assert (reported[:, 3] == reported[0, 3]).all(), (
        "interrupts, timers and registers are as at first"
    )
    assert (np.diff(reported[:, 4]) > 0).all(), "time goes on"


@pytest.mark.parametrize("seed", some(range(12), 3))
def test_cycles_are_counted_within_a_line_of_code(seed: int, tmp_path: Path) -> None:
    """Exactly, the first time that a line runs, too; never backwards."""
    rng = np.random.default_rng([12, seed])
    cycles = float(rng.choice([1.0, 2.0, 0.5, 3.25]))
    reads = 8
    gaps = rng.integers(0, 6, reads)
    fillers = ("nop", "nop.w", "adds r5, #1", "eor.w r5, r5, r4")
    line, counts = "", []
    for k, gap in enumerate(gaps):
        # The word read is stored again, and both are valid instructions, too.
        words = rng.choice(fillers, gap).tolist()
        line += "\\n ".join([*words, "ldr r4, [%0]", f"str r4, [%1, #{4 * k}]", ""])
        counts.append(gap + 2)
    elf = tiny(
        tmp_path,
        f"""
int main(void) {{
  static uint32_t seen[{reads}];
  for (int round = 0; round < 3; ++round) {{
    __asm__ volatile("b 1f\\n 1: {line}"
        :: "r"(0xe0001004), "r"(seen) : "r4", "r5", "memory", "cc");
    for (int k = 0; k < {reads}; ++k) put_word(seen[k]);
  }}
  for (;;) sleep();
}}
""",
    )
    board = write_board(tmp_path, cycles_per_instruction=cycles)
    reported = words_of(run_firmware(board, elf, 20))
    assert len(reported) == 3 * reads, "what was seen"
    assert all(a <= b for a, b in pairwise(reported)), "never backwards"
    for first in (0, reads, 2 * reads):
        steps = np.diff(reported[first : first + reads])
        expected = cycles * np.array(counts[1:])
        assert (np.abs(steps - expected) <= 1.0).all(), (steps, expected)
        assert abs(reported[first + reads - 1] - reported[first] - expected.sum()) <= 1.0, "in all"


def heard_while_debugged(folder: Path, elf: Path, work: Callable[[int], None]) -> bytes:
    """Run firmware while work(port) is a debugger; return what it has written to its line."""
    out, line = os.pipe()
    board = load_board(write_board(folder), SCENE.joint_names)
    chip = Microcontroller(board, ElfImage(elf), SCENE, {"line": (line, -1)})
    with socket.socket() as ours:
        ours.bind(("127.0.0.1", 0))
        ours.listen(1)
        thread = threading.Thread(target=work, args=(ours.getsockname()[1],))
        thread.start()
        chip.wait_for_debugger(ours)
        TableRun(SCENE, None, chip).advance(10)
        thread.join()
    os.close(line)
    heard = os.read(out, 65536)
    os.close(out)
    return heard


def test_walking_through_a_line_counts_the_same_cycles(tmp_path: Path) -> None:
    line = "\\n ".join(f"nop\\n ldr r4, [%0]\\n str r4, [%1, #{4 * k}]" for k in range(6))
    elf = tiny(
        tmp_path,
        f"""
int main(void) {{
  static uint32_t seen[6];
  for (int round = 0; round < 3; ++round) {{
    __asm__ volatile("b 1f\\n 1: {line}" ::"r"(0xe0001004), "r"(seen) : "r4", "memory");
    for (int k = 0; k < 6; ++k) put_word(seen[k]);
  }}
  for (;;) sleep();
}}
""",
    )

    def walk(port: int) -> None:
        with Debugger(port) as gdb:
            for _ in range(700):
                assert gdb.ask(b"s") == b"S05", "after a step"
                gdb.ask(b"me0001004,4")
            gdb.send(b"$D#44")

    free = run_firmware(write_board(tmp_path), elf, 10)
    assert len(free) == 4 * 18, "what it writes"
    assert heard_while_debugged(tmp_path, elf, walk) == free, "what it writes"


def test_masks_are_read_and_written_by_a_debugger(tmp_path: Path) -> None:
    elf = tiny(
        tmp_path,
        """
static volatile uint32_t ticks;
void SysTick_Handler(void) { ++ticks; }
__attribute__((noinline)) void here(void) { __asm__ volatile("nop"); }
int main(void) {
  SYSTICK_LOAD = 9999, SYSTICK_CTRL = 7;
  __asm__ volatile("msr psp, %0\\n msr basepri, %1" ::"r"(0x20002000), "r"(0x30));
  here();
  for (int k = 0; k < 20000; ++k) __asm__ volatile("nop");
  put_word(ticks);
  here();
  for (int k = 0; k < 20000; ++k) __asm__ volatile("nop");
  put_word(ticks);
  for (;;) sleep();
}
""",
    )
    names = {"msp": 0x22, "psp": 0x23, "primask": 0x24, "basepri": 0x25, "control": 0x27}
    masks: list[dict[str, int]] = []

    def work(port: int) -> None:
        with Debugger(port) as gdb:

            def all_of() -> dict[str, int]:
                return {
                    name: int.from_bytes(bytes.fromhex(gdb.ask(b"p%x" % number).decode()), "little")
                    for name, number in names.items()
                }

            assert b'"primask"' in gdb.ask(b"qXfer:features:read:target.xml:0,fff"), "announced"
            here = next(start for start, _, name in ElfImage(elf)._functions if name == "here")
            assert gdb.ask(b"Z0,%x,2" % here) == b"OK", "a breakpoint"
            assert gdb.ask(b"c") == b"S05", "at it"
            masks.append(all_of())
            assert gdb.ask(b"P25=00000000") == b"OK", "basepri"
            assert gdb.ask(b"P24=01000000") == b"OK", "primask"
            masks.append(all_of())
            assert gdb.ask(b"c") == b"S05", "at it again"
            assert gdb.ask(b"P24=00000000") == b"OK", "primask"
            gdb.send(b"$D#44")

    reported = words_of(heard_while_debugged(tmp_path, elf, work))
    assert masks[0]["psp"] == 0x20002000 and masks[0]["basepri"] == 0x30, masks
    assert (masks[0]["primask"], masks[1]["primask"], masks[1]["basepri"]) == (0, 1, 0), masks
    assert masks[0]["control"] == masks[1]["control"], masks
    assert reported[0] == 0 < reported[1], (
        "ticks while the debugger had masked them, and afterwards"
    )
