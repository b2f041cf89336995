"""Interrupts, tasks and faults of an emulated Cortex-M4F."""

from pathlib import Path

import numpy as np
import pytest
from cortex_m import (
    EXAMPLE,
    SCENE,
    TINY,
    chip_of,
    cross,
    elf_of,
    run_firmware,
    tiny,
    words_of,
    write_board,
)

from arm_emulator.runs.table_run import TableRun
from arm_emulator_firmware.microcontroller import FirmwareEnd

# Exceptions


class Model:
    """Order of handlers by the rules of ARMv7-M (B1.5), each a few lines of Python.

    Args:
        priorities: of interrupts.
        chains: what each handler pends, at its first run, its second, ...
        mask: of a priority that decides on preemption.
    """

    def __init__(self, priorities: list[int], chains: list[list[int]], mask: int) -> None:
        self.priorities, self.mask = priorities, mask
        self.chains = [list(chain) for chain in chains]
        self.pending: set[int] = set()
        self.active: list[int] = []
        self.basepri = 0
        self.log: list[int] = []

    def level(self) -> int:
        levels = [self.priorities[n] & self.mask for n in self.active]
        return min([256, *levels, *([self.basepri & self.mask] if self.basepri else [])])

    def dispatch(self) -> None:
        while self.pending:
            first = min(self.pending, key=lambda n: (self.priorities[n], n))
            if self.priorities[first] & self.mask >= self.level():
                return
            self.pending.remove(first)
            self.active.append(first)
            self.log.append(first)
            if self.chains[first]:
                self.pending.add(self.chains[first].pop(0))
                self.dispatch()
            self.log.append(first | 0x80)
            self.active.pop()


@pytest.mark.parametrize("seed", range(4))
def test_handlers_nest_as_their_priorities_state(seed: int, tmp_path: Path) -> None:
    """Priorities, groups, BASEPRI, PRIMASK, and handlers that pend others: drawn at random."""
    rng = np.random.default_rng([7, seed])
    K = 6
    numbers = sorted(rng.choice(82, K, replace=False).tolist())
    bits = int(rng.choice([3, 4, 8]))
    shift = 8 - bits
    priorities = [int(rng.integers(0, 1 << bits)) << shift for _ in range(K)]
    group = int(rng.integers(0, 8))
    chains = [rng.integers(0, K, int(rng.integers(0, 4))).tolist() for _ in range(K)]
    first = [k for k in range(K) if rng.random() < 0.6] or [0]
    basepri = int(rng.integers(1, 1 << bits)) << shift
    model = Model(priorities, chains, 0xFF & ~((2 << group) - 1))
    model.basepri = basepri
    model.pending = set(first)
    model.dispatch()
    model.log.append(0xEE)
    model.basepri = 0
    model.dispatch()
    rows = ", ".join(
        "{" + ", ".join(map(str, [*chain, *[0xFF] * (4 - len(chain))])) + "}" for chain in chains
    )
    vectors = "\n".join(f"[16 + {number}] = handler," for number in numbers)
    startup = (EXAMPLE / "startup.c").read_text().replace("[16 + 18] = ADC_Handler,", vectors)
    startup = startup.replace("typedef void (*handler)(void);", "typedef void (*handle)(void);")
    startup = startup.replace("const handler vectors", "const handle vectors")
    startup = startup.replace("(handler)&stack_top", "(handle)&stack_top")
    startup = startup.replace(
        "typedef void (*handle)", "void handler(void);\ntypedef void (*handle)"
    )
    (tmp_path / "startup.c").write_text(startup)
    (tmp_path / "main.c").write_text(
        f"""{TINY}
static const uint8_t numbers[{K}] = {{{", ".join(map(str, numbers))}}};
static const uint8_t priorities[{K}] = {{{", ".join(map(str, priorities))}}};
static const uint8_t chains[{K}][4] = {{{rows}}};
static volatile uint8_t next[{K}], log[512];
static volatile uint32_t count;
void handler(void) {{
  uint32_t ipsr, k = 0;
  __asm__ volatile("mrs %0, ipsr" : "=r"(ipsr));
  while (numbers[k] + 16u != ipsr) ++k;
  log[count++] = k;
  if (next[k] < 4 && chains[k][next[k]] != 0xff) {{
    const uint32_t other = numbers[chains[k][next[k]++]];
    ISPR(other) = 1u << other % 32;
    __asm__ volatile("dsb\\n isb" ::: "memory");
  }}
  log[count++] = k | 0x80;
}}
int main(void) {{
  __asm__ volatile("cpsid i" ::: "memory");
  REGISTER(0xe000ed0c) = 0x05fa0000 | {group} << 8;
  for (int k = 0; k < {K}; ++k) {{
    PRIORITY(numbers[k]) = priorities[k];
    ISER(numbers[k]) = 1u << numbers[k] % 32;
  }}
  {" ".join(f"ISPR(numbers[{k}]) = 1u << numbers[{k}] % 32;" for k in first)}
  __asm__ volatile("msr basepri, %0\\n cpsie i\\n isb" ::"r"({basepri}) : "memory");
  log[count++] = 0xee;
  __asm__ volatile("msr basepri, %0\\n isb" ::"r"(0) : "memory");
  for (uint32_t k = 0; k < count; ++k) put(log[k]);
  for (;;) sleep();
}}
"""
    )
    sources = [str(tmp_path / "startup.c"), str(tmp_path / "main.c")]
    elf = cross(tmp_path / "nest.elf", *sources, level=str(rng.choice(["-O0", "-O2", "-Os"])))
    heard = run_firmware(write_board(tmp_path, priority_bits=bits), elf)
    assert list(heard) == model.log, "handlers as they began (n) and ended (n + 128)"


SWITCH = """
static float sums[2][4];
static volatile uint32_t done, switches;
static uint32_t stacks[2][512];
static uint32_t* volatile tops[2];
static volatile uint32_t current;
static __attribute__((noinline)) void work(int n, int rounds) {
  float a = 1.0f + n, b = 0.5f, c = 0.25f, d = 3.0f;
  for (int k = 1; k <= rounds; ++k) {
    a = a * 0.999f + b / (float)k;
    b = b + c * a - d * 0.001f;
    c = c * 0.99f + 0.01f * (a > b ? a : -b);
    d = d - 0.125f * c / (1.0f + (float)(k % 7));
  }
  sums[n][0] = a, sums[n][1] = b, sums[n][2] = c, sums[n][3] = d;
}
"""

# Two tasks, switched as the kernels of operating systems do it: SVC begins, SysTick asks, PendSV
# switches, each task on a stack of its own and with registers of the FPU.
TASKS = """
static void task(int n) { work(n, ROUNDS); done |= 1u << n; for (;;) sleep(); }
static uint32_t* begin(int n) {
  uint32_t* top = &stacks[n][512] - 17;
  for (int k = 0; k < 17; ++k) top[k] = 0;
  top[8] = 0xfffffffd;
  top[9] = n;
  top[15] = (uint32_t)task;
  top[16] = 1u << 24;
  return top;
}
uint32_t* switch_task(uint32_t* top);
uint32_t* switch_task(uint32_t* top) {
  tops[current] = top;
  current ^= 1;
  ++switches;
  return tops[current];
}
__attribute__((naked)) void PendSV_Handler(void) {
  __asm__ volatile(
      "mrs r0, psp\\n isb\\n tst lr, #0x10\\n it eq\\n vstmdbeq r0!, {s16-s31}\\n"
      "stmdb r0!, {r4-r11, lr}\\n mov r4, #0x40\\n msr basepri, r4\\n dsb\\n isb\\n"
      "bl switch_task\\n mov r4, #0\\n msr basepri, r4\\n"
      "ldmia r0!, {r4-r11, lr}\\n tst lr, #0x10\\n it eq\\n vldmiaeq r0!, {s16-s31}\\n"
      "msr psp, r0\\n isb\\n bx lr");
}
__attribute__((naked)) void SVC_Handler(void) {
  __asm__ volatile(
      "ldr r0, =first\\n ldr r0, [r0]\\n ldmia r0!, {r4-r11, lr}\\n msr psp, r0\\n isb\\n bx lr");
}
uint32_t* first;
static volatile float noise;
void SysTick_Handler(void) {
  noise = noise * 0.5f + 1.0f;
  ICSR = 1u << 28;
}
int main(void) {
  tops[0] = begin(0), tops[1] = begin(1);
  first = tops[0];
  SHPR(10) = 0xf0, SHPR(11) = 0x80, SHPR(7) = 0x20;
  UART_CR = 0;
  SYSTICK_LOAD = LOAD, REGISTER(0xe000e018) = 0, SYSTICK_CTRL = 7;
  ISER(38) = 1u << 38 % 32;
  PRIORITY(38) = 0xe0;
  __asm__ volatile("cpsie i\\n svc 0\\n nop");
  for (;;) continue;
}
void report(void);
void report(void) {
  for (int n = 0; n < 2; ++n)
    for (int k = 0; k < 4; ++k) put_word(*(uint32_t*)&sums[n][k]);
  put_word(switches > 20);
}
"""


@pytest.mark.parametrize("seed", range(2))
def test_tasks_are_switched_as_operating_systems_do_it(seed: int, tmp_path: Path) -> None:
    """Interrupting two tasks anywhere does not change what they compute with floats."""
    rng = np.random.default_rng([8, seed])
    load, rounds = int(rng.integers(700, 3000)), 3000
    plain = f"""{SWITCH}
int main(void) {{
  (void)done, (void)switches, (void)stacks, (void)tops, (void)current;
  work(0, {rounds});
  work(1, {rounds});
  for (int n = 0; n < 2; ++n)
    for (int k = 0; k < 4; ++k) put_word(*(uint32_t*)&sums[n][k]);
  put_word(1);
  for (;;) sleep();
}}
"""
    expected = words_of(run_firmware(write_board(tmp_path), tiny(tmp_path, plain), 10))
    assert len(expected) == 9, "words of both tasks, one after the other"
    tasks = SWITCH + TASKS.replace("ROUNDS", str(rounds)).replace("LOAD,", f"{load},")
    tasks = tasks.replace(
        "done |= 1u << n;", "done |= 1u << n; if (n == 0) { while (done != 3) continue; report(); }"
    ).replace("static void task", "void report(void);\nstatic void task", 1)
    elf = tiny(tmp_path, tasks, str(rng.choice(["-O1", "-O2"])))
    assert words_of(run_firmware(write_board(tmp_path), elf, 20)) == expected, "words of both tasks"


# Faults

CULPRITS = {
    "read": ("(void)*(volatile uint32_t*){address:#x};", "read of an address where nothing is"),
    "write": ("*(volatile uint8_t*){address:#x} = 1;", "write to an address where nothing is"),
    "flash": ("*(volatile uint32_t*)({flash:#x}) = 1;", "write to flash"),
    "jump": ("((void (*)(void))({address:#x} | 1))();", "instructions from an address where none"),
    "ram": (
        "((void (*)(void))0x20000101)();",
        "instructions from RAM that is not of kind code_ram",
    ),
    "undefined": ('__asm__ volatile("udf #{number}");', "an undefined instruction"),
    "breakpoint": ('__asm__ volatile("bkpt #{number}");', "a breakpoint instruction"),
    "call": ('__asm__ volatile("cpsid i\\n svc #{number}");', "hard fault"),
    "recursion": ("again(k + 1);", "where nothing is"),
}


@pytest.mark.parametrize("kind", CULPRITS)
def test_a_fault_ends_the_run_in_a_line_with_its_function(kind: str, tmp_path: Path) -> None:
    rng = np.random.default_rng([6, *kind.encode()])
    text, words = CULPRITS[kind]
    hole = int(rng.choice([0, 0x1000, 0x08200000, 0x30000000, 0x90000000])) + 4 * int(
        rng.integers(99)
    )
    numbers = {
        "flash": 0x08000000 + 4 * int(rng.integers(1 << 18)),
        "number": int(rng.integers(200)),
    }
    body = text.format(address=hole, **numbers)
    elf = tiny(
        tmp_path,
        f"""
void culprit(volatile int k);
void (*volatile again)(volatile int) = culprit;
__attribute__((noinline)) void culprit(volatile int k) {{ (void)k; {body} sleep(); }}
int main(void) {{ sleep(); culprit(0); for (;;) sleep(); }}
""",
        "-O1",
    )
    board = write_board(tmp_path)
    with pytest.raises(FirmwareEnd) as end:
        run_firmware(board, tiny_awake(elf, tmp_path), 3)
    line = str(end.value)
    assert words in line and "\n" not in line, line
    if kind in ("read", "write"):
        assert f"({hole:#010x})" in line, line
    if kind not in ("jump", "ram"):
        assert "in culprit" in line, line


def tiny_awake(elf: Path, folder: Path) -> Path:
    """Return firmware the first sleep of which ends: its SysTick runs."""
    text = (folder / "tiny.c").read_text()
    text = text.replace(
        "int main(void) {", "int main(void) { SYSTICK_LOAD = 999; SYSTICK_CTRL = 7;"
    )
    (folder / "tiny.c").write_text(text + "void SysTick_Handler(void) {}\n")
    sources = [str(EXAMPLE / "startup.c"), str(folder / "tiny.c")]
    return cross(elf, *sources, level="-O1")


@pytest.mark.parametrize("seed", range(4))
def test_any_bits_are_run_or_end_in_a_line_twice_alike(seed: int, tmp_path: Path) -> None:
    """Flash full of random halfwords, half of them instructions that do much."""
    rng = np.random.default_rng([9, seed])
    flash, entries = 0x08000000, 98
    much = [0xBF30, 0xBF20, 0xB672, 0xB662, 0x4770, 0xDF00, 0xF3EF, 0x8010, 0xF380, 0x8811, 0xE7FE]
    much += [0x6001, 0x6808, 0xBD00, 0xB500, 0xF3BF, 0x8F6F, 0xBF10, 0xBE00, 0xED2D, 0xEE30]
    board = write_board(tmp_path, cycles_per_instruction=int(rng.choice([1, 50])))
    file = tmp_path / "random.elf"
    for _ in range(12):
        vectors = (flash + 4 * entries + 2 * rng.integers(0, 2000, entries)) | 1
        vectors[0] = 0x20020000
        code = rng.integers(0, 1 << 16, 4000)
        often = rng.random(len(code)) < rng.choice([0.0, 0.5])
        code[often] = rng.choice(much, int(often.sum()))
        file.write_bytes(
            elf_of(flash, vectors.astype("<u4").tobytes() + code.astype("<u2").tobytes())
        )
        ends = []
        for _ in range(2):
            chip = chip_of(SCENE, file, board)
            table_run = TableRun(SCENE, None, chip)
            try:
                table_run.advance(5)
                ends.append(f"{chip.figures.instructions} instructions")
            except FirmwareEnd as end:
                ends.append(str(end))
        assert ends[0] == ends[1] and "\n" not in ends[0], ends
