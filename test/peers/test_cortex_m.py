"""Unmodified firmware of a Cortex-M4F, built with a cross compiler, in the loop with a machine."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("unicorn", reason="no unicorn")
pytest.importorskip("elftools", reason="no pyelftools")
if shutil.which("arm-none-eabi-gcc") is None:
    pytest.skip("no arm-none-eabi-gcc", allow_module_level=True)

from arm_emulator.gains import load_gains
from arm_emulator.servo_header import servo_header
from arm_emulator.table_run import TableRun
from arm_emulator.target_table import TargetTable
from compiled.c_flags import C_FLAGS
from compiled.cxx import find_compiler
from emulator_node.compiler import CORE
from emulator_node.firmware import Firmware
from emulator_node.scene import Scene, load_scene
from firmware import FOLDER as SERVO
from microcontroller import FOLDER
from microcontroller.board import load_board
from microcontroller.elf_image import ElfImage
from microcontroller.microcontroller import FirmwareEnd, Microcontroller
from words.config_files import find_scene

EXAMPLE = FOLDER / "examples/stm32f4_like"
CROSS = (
    "arm-none-eabi-gcc -mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16 -std=gnu99 -g"
    " -ffp-contract=off -ffreestanding -fno-strict-aliasing -Wall -Wextra -Werror"
    " -nostartfiles --specs=nosys.specs -Wl,--no-warn-rwx-segments"
).split()
SCENE = load_scene("three_axis")

# What small programs are made of: registers, a serial line, and a handler that may be defined.
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
        one = TableRun(SCENE, None, Microcontroller(read, ElfImage(elf), SCENE, lines))
        one.advance(ticks)
    finally:
        os.close(theirs)
        listener.join()
        os.close(ours)
    return bytes(heard)


def words_of(heard: bytes) -> list[int]:
    return np.frombuffer(heard, "<u4").tolist()


# The example, and the same code as a library


@pytest.fixture(scope="module")
def ur5() -> Scene:
    return load_scene("ur5")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory, ur5: Scene) -> Callable[..., Path]:
    folder = tmp_path_factory.mktemp("example")
    servo = load_gains(find_scene("ur5")).servo
    (folder / "servo_joints.h").write_text(servo_header("ur5", ur5.joint_names, servo))

    def build(name: str, *flags: str, level: str = "-O2") -> Path:
        sources = [EXAMPLE / "startup.c", EXAMPLE / "main.c", EXAMPLE / "control.c"]
        words = [*map(str, sources), str(SERVO / "servo.c"), "-DSERVO_FLOAT", *flags]
        return cross(folder / name, *words, level=level)

    return build


def random_table(rng: np.random.Generator, scene: Scene, ticks: int) -> TargetTable:
    start = np.asarray(scene.start)
    t = np.sort(rng.choice(ticks, 4, replace=False)) * scene.servo_period
    return TargetTable(t, start + rng.uniform(-0.1, 0.1, (4, len(start))))


def states(one: TableRun, ticks: int) -> list[bytes]:
    """Go on tick by tick; return the machine's whole state at each."""
    saved = []
    for _ in range(ticks):
        one.advance(1)
        saved.append(one.session.plant.save())
    return saved


def chip_of(scene: Scene, elf: Path, board: Path = EXAMPLE / "board.yaml") -> Microcontroller:
    return Microcontroller(load_board(board, scene.joint_names), ElfImage(elf), scene)


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
    folders = [f"-I{one}" for one in (SERVO, CORE, EXAMPLE, folder)]
    objects = []
    for source in (folder / f"{name}.c", EXAMPLE / "control.c", SERVO / "servo.c"):
        objects.append(str(folder / f"{source.stem}.o"))
        host_cc(*C_FLAGS, "-DSERVO_FLOAT", *folders, "-c", str(source), "-o", objects[-1])
    host_cc("-shared", *objects, "-lm", "-o", str(folder / f"{name}.so"))
    return Firmware(folder / f"{name}.so")


def host_cc(*words: str) -> None:
    done = subprocess.run([*find_compiler(), *words], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), "exit code and words of the compiler"


def test_firmware_moves_the_arm_as_the_same_code_in_a_library(
    built: Callable[..., Path], ur5: Scene
) -> None:
    """Other compilers, levels and processors, asleep or not, one motion to the last bit."""
    elf = built("asleep.elf")
    rng = np.random.default_rng(1)
    table = random_table(rng, ur5, 300)
    wanted = states(TableRun(ur5, table, library_of_example(elf.parent)), 300)
    assert len({*wanted}) == 300, "states of a machine that moves"
    for name, level in (("asleep.elf", "-O2"), ("small.elf", "-Os")):
        one = TableRun(ur5, table, chip_of(ur5, built(name, level=level)))
        assert states(one, 300) == wanted, f"the machine at each tick with {level}"
    awake = TableRun(ur5, table, chip_of(ur5, built("awake.elf", "-DAWAKE")))
    assert states(awake, 100) == wanted[:100], "the machine at each tick, never asleep"


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
    seen = set()
    for _ in range(10):
        chip = chip_of(ur5, elf)
        one = TableRun(ur5, table, chip)
        one.advance(200)
        figures = chip.figures
        seen.add((one.session.plant.save(), figures.instructions, figures.cycles, figures.asleep))
    assert len(seen) == 1, "states, instructions and cycles of ten runs"


def test_two_chips_know_nothing_of_each_other(built: Callable[..., Path], ur5: Scene) -> None:
    elf = built("asleep.elf")
    table = random_table(np.random.default_rng(3), ur5, 50)
    alone = states(TableRun(ur5, table, chip_of(ur5, elf)), 60)
    one, other = (TableRun(ur5, table, chip_of(ur5, elf)) for _ in range(2))
    for tick in range(60):
        one.advance(1)
        other.advance(1)
        assert one.session.plant.save() == other.session.plant.save() == alone[tick], tick


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
        while (one := self._stream.read(1)) != b"$":
            assert one, "an open connection"
        text = b""
        while (one := self._stream.read(1)) != b"#":
            text += one
        self._stream.read(2)
        return text

    def __enter__(self) -> Debugger:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()
        self._socket.close()


def course(
    chip: Microcontroller, scene: Scene, table: TargetTable | None, ticks: int
) -> list[tuple[bytes, int, int, int]]:
    """Go on tick by tick; return the machine's state and what the processor has done at each."""
    one, seen = TableRun(scene, table, chip), []
    for _ in range(ticks):
        one.advance(1)
        done = chip.figures
        seen.append((one.session.plant.save(), done.instructions, done.asleep, done.exceptions))
    return seen


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
        chip.debug(listening)
    try:
        return course(chip, scene, table, ticks)
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
    free = course(chip_of(ur5, elf), ur5, table, ticks)
    lines = ["set pagination off", "break control_step", "continue", "print *encoder", "backtrace"]
    for _ in range(6):
        what = rng.choice(["stepi", "next", "continue", "middle"])
        if what == "stepi":
            lines.append(f"stepi {rng.integers(1, 60)}")
        elif what == "middle":
            lines += [f"tbreak *(servo_voltage+{4 * rng.integers(1, 12)})", "continue"]
        else:
            lines.append(str(what))
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
    said = []

    def gdb(port: int) -> None:
        command = ["gdb-multiarch", "-nx", "-batch", str(elf)]
        command += ["-ex", f"target remote :{port}", "-x", str(script)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        said.append(done.stdout + done.stderr)

    halted = debugged(chip_of(ur5, elf), ur5, table, ticks, gdb)
    assert "Breakpoint 1, control_step" in said[0] and "ADC_Handler" in said[0], said[0]
    assert halted == free, f"the machine at each tick, debugged and free\n{said[0]}"


def test_every_step_and_any_packet_of_a_debugger_change_no_bit(
    built: Callable[..., Path], ur5: Scene
) -> None:
    """Walking through a whole period, interrupts from the terminal, packets that are none."""
    elf = built("asleep.elf")
    rng = np.random.default_rng(5)
    table = random_table(rng, ur5, 8)
    free = course(chip_of(ur5, elf), ur5, table, 300)
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
    "reset": ("REGISTER(0xe000ed0c) = 0x05fa0004;", "a reset that the firmware asked for"),
    "recursion": ("again(k + 1);", "where nothing is"),
}


@pytest.mark.parametrize("kind", CULPRITS)
def test_a_fault_ends_the_run_in_one_line_with_its_function(kind: str, tmp_path: Path) -> None:
    rng = np.random.default_rng([6, *kind.encode()])
    text, what = CULPRITS[kind]
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
    assert what in line and "\n" not in line, line
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


# Exceptions


class Model:
    """Which handler runs when, by the rules of ARMv7-M (B1.5), each a few lines of Python.

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
def test_handlers_nest_as_their_priorities_say(seed: int, tmp_path: Path) -> None:
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
    """What two tasks compute with floats does not change when they are torn apart anywhere."""
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
    wanted = words_of(run_firmware(write_board(tmp_path), tiny(tmp_path, plain), 10))
    assert len(wanted) == 9, "words of both tasks, one after the other"
    tasks = SWITCH + TASKS.replace("ROUNDS", str(rounds)).replace("LOAD,", f"{load},")
    tasks = tasks.replace(
        "done |= 1u << n;", "done |= 1u << n; if (n == 0) { while (done != 3) continue; report(); }"
    ).replace("static void task", "void report(void);\nstatic void task", 1)
    elf = tiny(tmp_path, tasks, str(rng.choice(["-O1", "-O2"])))
    assert words_of(run_firmware(write_board(tmp_path), elf, 20)) == wanted, "words of both tasks"


def elf_of(at: int, content: bytes) -> bytes:
    """Return an ELF file for Arm that loads some bytes."""
    header = b"\x7fELF\x01\x01\x01" + bytes(9)
    for size, value in ((2, 2), (2, 40), (4, 1), (4, at), (4, 52), (4, 0), (4, 0)):
        header += value.to_bytes(size, "little")
    for value in (52, 32, 1, 40, 0, 0):
        header += value.to_bytes(2, "little")
    segment = (1, 84, at, at, len(content), len(content), 5, 4)
    return header + b"".join(value.to_bytes(4, "little") for value in segment) + content


@pytest.mark.parametrize("seed", range(4))
def test_any_bits_are_run_or_end_in_one_line_twice_alike(seed: int, tmp_path: Path) -> None:
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
            one = TableRun(SCENE, None, chip)
            try:
                one.advance(5)
                ends.append(f"{chip.figures.instructions} instructions")
            except FirmwareEnd as end:
                ends.append(str(end))
        assert ends[0] == ends[1] and "\n" not in ends[0], ends


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
    """The template of docs/firmware.md, its FLOAT build, against the servo on a chip."""
    servo = load_gains(find_scene("three_axis")).servo
    (tmp_path / "servo_joints.h").write_text(servo_header("three_axis", SCENE.joint_names, servo))
    objects = []
    for source in (SERVO / "template/mine.c", SERVO / "servo.c"):
        objects.append(str(tmp_path / f"{source.stem}.o"))
        folders = [f"-I{one}" for one in (SERVO, CORE, tmp_path)]
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
  servo_measure(&arm, now, counts, current, voltage);
  servo_aim(&arm, q, 0, 0);
  servo_voltage(&arm, 1, voltage);
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
    wanted = states(TableRun(SCENE, table, Firmware(tmp_path / "mine.so")), 300)
    chip = chip_of(SCENE, elf, write_board(tmp_path, **FLOATS))
    assert states(TableRun(SCENE, table, chip), 300) == wanted, "the machine at each tick"


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
    duty = [min(one / (top + edge), 1.0) for one in (*compare, minus)]
    sign = -1 if seed % 2 else 1
    voltage = [supply * (2 * duty[0] - 1), sign * supply * duty[1], supply * (duty[2] - duty[3])]
    voltage[disabled] = 0.0
    loop = TableRun(SCENE, None, Firmware(library_that_drives(voltage, disabled, tmp_path)))
    begun: list[int] = []
    for tick in range(ticks):
        measured = loop.session.measured
        counts = [int(one) for one in measured.encoder_counts]
        begun = begun or counts
        wanted = [
            (first + one - zero) % 2**b for one, zero, b in zip(counts, begun, bits, strict=True)
        ]
        wanted += [
            int(min(max(np.floor(one * s + o + 0.5), 0), 2**b - 1))
            for one, s, o, b in zip(measured.current, scale, offset, adc_bits, strict=True)
        ]
        assert heard[tick].tolist() == wanted, f"registers at tick {tick}"
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
    host_cc(*C_FLAGS, f"-I{CORE}", str(folder / "drives.c"), "-o", str(library))
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
    """Run firmware with a serial line to which some bytes are sent first; return what it says."""
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


def test_targets_come_along_a_serial_line(tmp_path: Path) -> None:
    table = random_table(np.random.default_rng(14), SCENE, 20)
    heard = line_run(tmp_path, ECHO, table, b"", 30, targets=True)
    rows = table.q if table.t[0] == 0.0 else np.vstack([SCENE.start, table.q])
    wanted = b""
    for row in rows:
        numbers = row.astype("<f4").tobytes()
        wanted += b"\xa5\x5a" + numbers + bytes([sum(numbers) % 256])
    assert heard == wanted, "frames of the table's rows"


@pytest.mark.parametrize("free", [False, True])
def test_systick_and_the_cycle_counter_agree(free: bool, tmp_path: Path) -> None:
    """A sleeping processor wakes in the very cycle, whatever instructions take."""
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
        wanted = [(k * (load + 1) >> 4) % 256 for k in range(1, len(times) + 1)]
        assert times.tolist() == wanted, "the cycle counter at each tick"
    else:
        times = np.array(words_of(heard))
        assert (np.diff(times) == load + 1).all(), "cycles from tick to tick"
    assert len(times) == 8 * 168_000 // (load + 1), "ticks in 8 ms"


def test_firmware_that_waits_where_no_time_passes_ends_in_one_line(tmp_path: Path) -> None:
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
