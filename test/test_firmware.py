"""Control code in C: our servo as portable C, a user's library in the loop, a table of targets."""

from __future__ import annotations

import dataclasses
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some
from in_process import in_process
from network import bits_of
from sensor_msgs.msg import JointState

from arm_emulator.base.refusal import Refusal
from arm_emulator.build.c_header import CData, pointer
from arm_emulator.build.compiler_command import find_compiler
from arm_emulator.build.flags import C_FLAGS
from arm_emulator.build.unit import library
from arm_emulator.cli.command_line import main
from arm_emulator.cli.commands.servo_header import header_text
from arm_emulator.core import BOUNDARY
from arm_emulator.machine.firmware import Doing, Firmware
from arm_emulator.machine.firmware_loop import firmware_loop
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.scene import load_scene
from arm_emulator.machine.session import Session
from arm_emulator.runs import guarded
from arm_emulator.runs.servo_step import ServoStep, servo_step_unit
from arm_emulator.runs.table_run import TableRun, load_table_run
from arm_emulator.runs.target_table import load_target_table
from arm_emulator.servo.c import FOLDER
from arm_emulator.servo.drives import Drives, Target
from arm_emulator.servo.servo import load_servo_config
from arm_emulator.servo.servo_law import servo_law

ROOT = Path(__file__).resolve().parents[1]
SERVO = load_servo_config(ROOT / "config/servo/three_axis.yaml")
SCENE = load_scene("three_axis")
NAMES, N = SCENE.joint_names, len(SCENE.joints)
WARNINGS = "-Wall -Wextra -pedantic -Werror".split()
MORE_WARNINGS = ["-Wconversion", "-Wdouble-promotion"]
MOTION_TICKS = round(SERVO.motion_period / SERVO.period)


def compile_c(out: Path, *words: str) -> None:
    """Compile as our own C is compiled, and fail on any warning."""
    folders = [f"-I{folder}" for folder in (FOLDER, BOUNDARY, out.parent)]
    run_c([*find_compiler(), *C_FLAGS, *WARNINGS, *folders, *words, "-o", str(out)])


def run_c(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), "exit code and words of the compiler"


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Build the template with our servo's numbers for three_axis, or other code, as a library."""
    folder = tmp_path_factory.mktemp("built")
    (folder / "servo_joints.h").write_text(header_text("three_axis", NAMES, SERVO))
    made: dict[tuple[str, ...], Path] = {}

    def built(source: str = "", *flags: str) -> Path:
        if (source, *flags) not in made:
            file = folder / f"mine_{len(made)}.c"
            file.write_text(source or (FOLDER / "template/mine.c").read_text())
            library, objects = file.with_suffix(".so"), []
            for one in [file] if source else [file, FOLDER / "servo.c"]:
                objects.append(file.with_suffix(f".{one.stem}.o"))
                compile_c(objects[-1], *flags, "-c", str(one))
            run_c([*find_compiler(), "-shared", *map(str, objects), "-o", str(library)])
            made[source, *flags] = library
        return made[source, *flags]

    return built


def code(step: str, start: str = "0", version: str = "FIRMWARE_VERSION") -> str:
    """Return control code with the body of a step."""
    return f"""
#include "firmware.h"
static void step(const firmware_input* in, firmware_output* out) {{
  (void)in, (void)out;
  {step}
}}
const firmware* arm_firmware(void) {{
  static const firmware mine = {{{version}, 0, {start}, step}};
  return &mine;
}}
"""


def random_table(rng: np.random.Generator, file: Path, every: int = 1) -> list[list[float]]:
    """Write a table, columns in any order, times at multiples of so many ticks; return its rows."""
    steps = rng.integers(1, 6, int(rng.integers(2, 8)))
    ticks = np.concatenate([[0], np.cumsum(steps)[:-1]]) * every
    q = SCENE.start + rng.uniform(-0.15, 0.15, (len(ticks), N))
    rows = [[tick / 1000, *row] for tick, row in zip(ticks.tolist(), q.tolist(), strict=True)]
    columns = ["t", *NAMES]
    order = rng.permutation(N + 1)
    lines = [",".join(f" {columns[k]} " for k in order)]
    lines += [",".join(repr(row[k]) for k in order) for row in rows]
    end = str(rng.choice(["\n", "\r\n", "\n\n"]))
    file.write_text(str(rng.choice(["", "\ufeff"])) + end.join(lines) + end, encoding="utf-8")
    return rows


def row_at(rows: list[list[float]], tick: int) -> list[float]:
    return [row for row in rows if round(row[0] * 1000) <= tick][-1][1:]


def states_of(run: TableRun, ticks: int) -> dict[int, bytes]:
    session, states = run.session, {}
    while True:
        measured = session.measured
        states[session.tick] = bits_of(measured.encoder_counts, measured.current)
        if session.tick == ticks:
            return states
        run.advance(1)


# Portable C


@pytest.mark.parametrize("level", some(["-O2", "-O0", "-Os", "-O3"], 2))
@pytest.mark.parametrize("kind", ["double", "float"])
def test_the_servo_needs_nothing_but_itself(kind: str, level: str, tmp_path: Path) -> None:
    """No C library, no heap: nothing is asked for that the object does not have."""
    if shutil.which("nm") is None:
        pytest.skip("no nm")
    words = ["-x", "c", "-std=c99", level, "-ffreestanding", "-nostdlib"]
    words += [*WARNINGS, *MORE_WARNINGS, "-c"]
    words += ["-DSERVO_FLOAT"] if kind == "float" else []
    made = tmp_path / "servo.o"
    run_c([*find_compiler(), *words, str(FOLDER / "servo.c"), "-o", str(made)])
    lacks = subprocess.run(["nm", "-u", str(made)], capture_output=True, text=True, check=True)
    assert lacks.stdout == "", "symbols that it lacks"


def test_all_of_our_c_compiles_without_a_warning(tmp_path: Path) -> None:
    for number, source in enumerate(
        [BOUNDARY / "firmware_loop.c", ROOT / "arm_emulator/runs/servo_step.c"]
    ):
        compile_c(tmp_path / f"{number}.so", *MORE_WARNINGS, "-c", str(source))


def test_a_servo_that_has_measured_nothing_gives_no_voltage() -> None:
    """For any target the output is 0 V: the positions of the motors are unknown."""
    drives, law = Drives(SERVO), servo_law()
    arm, voltage = drives.servo.arm, np.full(N, np.nan)
    drives.aim(Target(np.ones(N)))
    law.servo_command(arm, True, pointer(voltage))
    np.testing.assert_array_equal(voltage, np.zeros(N), err_msg="before the first measurement")
    drives.measure(0, [0] * N, [0.0] * N)
    drives.aim(Target(np.ones(N)))
    assert (drives.command(powered=True) > 0.0).all(), "after it, towards the target"
    drives.reset()
    law.servo_command(arm, True, pointer(voltage))
    np.testing.assert_array_equal(voltage, np.zeros(N), err_msg="after a reset")


def test_fast_math_is_refused_by_the_compiler(tmp_path: Path) -> None:
    for flag in ("-ffast-math", "-ffinite-math-only"):
        command = [*find_compiler(), *C_FLAGS, flag, "-c", str(FOLDER / "servo.c")]
        command += ["-o", str(tmp_path / "servo.o")]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode != 0 and "compile without -ffast-math" in done.stderr, flag


# One law


def node_states(rows: list[list[float]], ticks: int) -> dict[int, bytes]:
    """The nodes of emulator and servo in lock-step, and the table as motion controller."""
    with in_process() as nodes:

        def answer(states: JointState) -> None:
            tick = round(states.header.stamp.sec * 1e3 + states.header.stamp.nanosec * 1e-6)
            targets = JointState(header=states.header, name=NAMES, position=row_at(rows, tick))
            nodes.send("joint_targets", targets)

        nodes.listen_alone("joint_states", JointState, answer)
        nodes.run_to(ticks)
        return dict(nodes.states)


def by_hand(rows: list[list[float]], ticks: int) -> dict[int, bytes]:
    """Python takes every servo period: `Drives` and `Session`."""
    session, drives = Session(SCENE, "lockstep", "first_answer"), Drives(SERVO)
    states = {}
    for tick in range(ticks + 1):
        measured = session.measured
        states[tick] = bits_of(measured.encoder_counts, measured.current)
        drives.measure(
            session.logical_ns, measured.encoder_counts, measured.current, measured.applied
        )
        drives.aim(Target(np.array(row_at(rows, tick))))
        session.offer(tick, NAMES, drives.command(session.powered).tolist())
        session.advance()
    return states


@pytest.mark.parametrize("seed", some(range(6), 1))
def test_library_node_and_runs_without_a_network_give_the_same_bits(
    seed: int, build: Callable[..., Path], tmp_path: Path
) -> None:
    rng = np.random.default_rng([seed, 13])
    rows = random_table(rng, tmp_path / "table.csv", MOTION_TICKS)
    table = load_target_table(tmp_path / "table.csv", NAMES)
    ticks = round(1000 * rows[-1][0]) + 300
    of_library = TableRun(SCENE, table, Firmware(build()))
    reported = states_of(of_library, ticks)
    of_servo, _ = load_table_run("three_axis", tmp_path / "table.csv", None)
    for name, other in (
        ("our servo, no library", states_of(of_servo, ticks)),
        ("Python in every period", by_hand(rows, ticks)),
        ("nodes in lock-step", node_states(rows, ticks)),
    ):
        wrong = [tick for tick in range(ticks + 1) if reported[tick] != other[tick]]
        assert not wrong, f"{name}: first difference at tick {wrong[0]} of {ticks}"
    # Once more in one call, and the library begins anew.
    again = TableRun(SCENE, table, Firmware(build()))
    again.advance(ticks)
    assert again.session.plant.save() == of_library.session.plant.save(), "all that a machine is"
    off = np.abs(again.session.state.q - rows[-1][1:])
    assert off.max() < 0.02, "the arm has followed the table [rad]"


def test_the_order_of_the_servos_joints_means_nothing(tmp_path: Path) -> None:
    rng = np.random.default_rng(18)
    random_table(rng, tmp_path / "table.csv", 20)
    table = load_target_table(tmp_path / "table.csv", NAMES)
    saved = set()
    for order in ([0, 1, 2], [2, 0, 1], [1, 0, 2]):
        config = dataclasses.replace(SERVO, joints=tuple(SERVO.joints[k] for k in order))
        run = TableRun(SCENE, table, ServoStep(Drives(config), order))
        run.advance(200)
        saved.add(run.session.plant.save())
    assert len(saved) == 1, "machines after 200 ticks, by the servo's order of joints"


@pytest.mark.parametrize("seed", some(range(8), 2))
def test_single_precision_moves_the_arm_as_double(
    seed: int, build: Callable[..., Path], tmp_path: Path
) -> None:
    """At rest both stand in the target's count; on the way they may be some counts apart.

    Angles of a motor up to 100 rad are rounded to 4e-6 rad, a thousandth of a count. So now and
    then a count is seen a tick earlier or later, and each moves the observed speed by a share of
    omega_gain, 0.2 counts per ms here, until the loops have taken it back, within some 10 ms: a few
    counts, 3.2 in 12 draws.
    """
    rng = np.random.default_rng([seed, 14])
    random_table(rng, tmp_path / "table.csv", 200)
    table = load_target_table(tmp_path / "table.csv", NAMES)
    runs = [
        TableRun(SCENE, table, Firmware(build("", *flags))) for flags in ((), ("-DSERVO_FLOAT",))
    ]
    count = np.array([joint.count_angle for joint in SERVO.joints])
    ticks = round(1000 * float(table.t[-1])) + 1000
    apart = np.zeros(N)
    for _ in range(0, ticks, 10):
        for run in runs:
            run.advance(10)
        q = [run.session.state.q for run in runs]
        apart = np.maximum(apart, np.abs(q[0] - q[1]) / count)
    assert (apart <= 5.0).all(), f"links apart on the way, in counts: {apart}"
    assert (np.abs(q[0] - q[1]) <= count).all(), f"links apart at rest: {q}"
    assert apart.max() > 0.0, "single precision is another computation"


# The table


def test_targets_hold_from_their_row_to_the_next(
    build: Callable[..., Path], tmp_path: Path
) -> None:
    """A library that gives its targets as voltages, against the rows by hand."""
    library = build(
        code("for (int j = 0; j < 3; ++j) out->joint[j].value = in->q_target[j] * in->new_targets;")
    )
    rng = np.random.default_rng(15)
    for _ in range(5):
        rows = random_table(rng, tmp_path / "table.csv")
        late = float(rng.integers(0, 4)) / 1000  # before the first row: where the arm starts
        table = load_target_table(tmp_path / "table.csv", NAMES)
        table = type(table)(table.t + late, table.q)
        rows = [[-1.0, *SCENE.start], *([t + late, *q] for t, *q in rows)]
        run = TableRun(SCENE, table, Firmware(library))
        for tick in range(50):
            run.advance(1)
            np.testing.assert_array_equal(
                run.session.measured.applied, row_at(rows, tick), err_msg=f"targets of tick {tick}"
            )


GOOD = "t,waist,shoulder,elbow\n0,0.1,0.2,0.3\n0.5,0.1,0.2,0.3\n"
BAD_TABLES = {
    "": "columns must be t and every joint of the scene once, got none",
    "\n\n": "columns must be t",
    "t,waist,shoulder\n0,0,0\n": "every joint of the scene once, got t, waist, shoulder; valid",
    "t,waist,shoulder,elbow,elbow\n0,0,0,0,0\n": "columns must be t",
    "t,waist,shoulder,knee\n0,0,0,0\n": "got t, waist, shoulder, knee; valid: t, waist",
    "waist,shoulder,elbow\n0,0,0\n": "columns must be t",
    "0,0.1,0.2,0.3\n": "columns must be t",
    "t,waist,shoulder,elbow\n": "table must have a row of targets, got none",
    GOOD + "1.0,0.1,0.2\n": "line 4 must have 4 values, as the columns, got 3",
    GOOD + "1.0,0.1,0.2,0.3,0.4\n": "line 4 must have 4 values, as the columns, got 5",
    GOOD + "1.0,0.1,,0.3\n": "line 4, shoulder must be a number [rad or m], got nothing",
    GOOD + ",0.1,0.2,0.3\n": "line 4, t must be a number [s], got nothing",
    GOOD + "1.0,0.1,nan,0.3\n": "line 4, shoulder must be a number [rad or m], got nan",
    GOOD + "1.0,0.1,0.2,-inf\n": "line 4, elbow must be a number",
    GOOD + "1.0,0.1,0.2,1e400\n": "line 4, elbow must be a number",
    GOOD + "1.0,0.1,0.2,three\n": "line 4, elbow must be a number [rad or m], got three",
    GOOD + "1.0,0.1,0.2,1_0\n": "line 4, elbow must be a number",
    GOOD + "1.0,0.1,0.2,2e6\n": "line 4, elbow must be within +-1e+06 rad or m, got 2000000.0",
    GOOD + "0.5,0.1,0.2,0.3\n": "line 4, t must be later than the previous row's, 0.5 s",
    GOOD + "0.4,0.1,0.2,0.3\n": "line 4, t must be later than the previous row's, 0.5 s",
    GOOD + "nan,0.1,0.2,0.3\n": "line 4, t must be a number [s], got nan",
    GOOD + "1e12,0.1,0.2,0.3\n": "line 4, t must be from 0 to 1e+09 s",
    "t,waist,shoulder,elbow\n-1,0,0,0\n": "line 2, t must be from 0 to 1e+09 s, got -1.0",
    GOOD + '1.0,"0.1,0.2,0.3\n': "must be well-formed CSV",
    "\udcff\udcfe": "file must be text in UTF-8",
    "\0": "table.csv: ",
}


@pytest.mark.parametrize("text", BAD_TABLES)
def test_files_without_a_table_are_refused_in_a_line(text: str, tmp_path: Path) -> None:
    file = tmp_path / "table.csv"
    file.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(Refusal) as refusal:
        load_target_table(file, NAMES)
    assert BAD_TABLES[text] in str(refusal.value) and str(refusal.value).startswith("table.csv: ")
    assert len(str(refusal.value).splitlines()) == 1, f"one line, got {refusal.value}"


def test_tables_that_are_spoiled_at_random_are_taken_whole_or_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(16)
    taken, file = 0, tmp_path / "table.csv"
    for _ in range(200):
        random_table(rng, file)
        body = bytearray(file.read_bytes())
        for _ in range(int(rng.integers(1, 4))):
            at = int(rng.integers(len(body)))
            match int(rng.integers(3)):
                case 0:
                    body[at] = int(rng.choice(list(b'0123456789.,-e\n\r"nt \xff\0')))
                case 1:
                    del body[at : at + int(rng.integers(1, 9))]
                case _:
                    body[at:at] = body[: int(rng.integers(1, 30))]
        file.write_bytes(bytes(body))
        try:
            table = load_target_table(file, NAMES)
        except Refusal as refusal:
            assert len(str(refusal).splitlines()) == 1, f"one line, got {refusal}"
            continue
        taken += 1
        assert np.isfinite(table.q).all() and (np.diff(table.t) > 0.0).all(), body
        assert table.q.shape == (len(table.t), N), body
    assert 0 < taken < 200, f"{taken} taken: the draws are one-sided"


# Libraries


NO_TABLE = "t,waist,shoulder,elbow\n0,0,0.5,0.8\n1,0,0.5,0.8\n"


def command(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], *words: Any
) -> tuple[int, str, str]:
    """Run a command of ours in this process (a library of a user's in a child of it).

    Return its exit code and what was printed, but for what is compiled once.
    """
    Plant(SCENE), firmware_loop(), servo_law(), library(servo_step_unit())
    capfd.readouterr()
    monkeypatch.setattr(sys, "argv", ["arm_emulator", *map(str, words)])
    with pytest.raises(SystemExit) as end:
        main()
    printed = capfd.readouterr()
    return int(end.value.code or 0), printed.out, printed.err


STEP = "out->joint[1].value = in->measured->tick"
BAD_LIBRARIES: dict[str, tuple[str | bytes | None, str]] = {
    "missing": (None, "mine.so: file must be readable, got no such file"),
    "text": (
        b"int main;",
        "file must be a shared library with arm_firmware, got it is not a 64-bit",
    ),
    "empty": (b"", "got it is empty"),
    "entry": ("int other(void);\nint other(void) { return 1; }\n", "got it lacks arm_firmware"),
    "null": (
        '#include "firmware.h"\nconst firmware* arm_firmware(void) { return 0; }\n',
        "arm_firmware must return the library's functions, got a null pointer",
    ),
    "version": (code("", version="7"), "version must be 1, that of firmware.h, got 7"),
    "no step": (
        '#include "firmware.h"\nconst firmware* arm_firmware(void) {'
        " static const firmware mine = {1, 0, 0, 0}; return &mine; }\n",
        "step must be a function, got a null pointer",
    ),
    "declines": (
        '#include "firmware.h"\nstatic const char* no(const firmware_machine* m) '
        '{ return m->joints == 3 ? "made for\\nfive joints" : 0; }\n' + code("", "no"),
        "start must take scene three_axis, got made for five joints",
    ),
    "nan": (
        code(f"{STEP} == 7 ? 0.0 / ((double)in->time - 7e6) : 0.0;"),
        "tick 7: value of shoulder must be finite, got",
    ),
    "inf": (code(f"{STEP} == 2 ? 1e308 * (double)in->time : 0.0;"), "tick 2: value of shoulder"),
    "mode": (code("out->joint[2].mode = 99;"), "tick 0: mode of elbow must be one that the drive"),
    "lacking": (
        "extern int nowhere(int);\n" + code("out->joint[0].value = nowhere(1);"),
        "file must be loaded by the system, got ",
    ),
}


@pytest.mark.parametrize("what", BAD_LIBRARIES)
def test_a_library_that_cannot_be_run_is_refused_in_a_line(
    what: str,
    build: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    made, words = BAD_LIBRARIES[what]
    library, table = tmp_path / "mine.so", tmp_path / "table.csv"
    table.write_text(NO_TABLE)
    if isinstance(made, bytes):
        library.write_bytes(made)
    elif made is not None:
        shutil.copy(build(made), library)
    arguments = ("run", "three_axis", "--servo", library, "--targets", table)
    exit_code, out, printed = command(monkeypatch, capfd, *arguments)
    assert (exit_code, out) == (2, ""), printed
    assert printed.startswith("mine.so") and words in printed and printed.count("\n") == 1, printed


# Ways in which a library ends the process, and what is reported of it.
ENDS = {
    "exit(0);": "exit with code 0",
    "exit(3);": "exit with code 3",
    "_exit(0);": "exit with code 0",
    "quick_exit(0);": "exit with code 0",
    "abort();": "SIGABRT",
    "*(volatile int*)8 = 1;": "SIGSEGV",
    "raise(SIGFPE);": "SIGFPE",
    "__builtin_trap();": "SIG(ILL|TRAP)",
    "raise(SIGKILL);": "SIGKILL",
    "deeper(1);": "SIGSEGV",
    "pthread_exit(0);": "exit with code 0",
    'execl("/bin/true", "true", (char*)0);': "exit with code 0",
}
HEADERS = """
#include <pthread.h>
#include <signal.h>
#include <stdlib.h>
#include <unistd.h>
static volatile int sum;
static void deeper(int k) {
  volatile char room[4096];
  room[0] = (char)k, deeper(k + room[0]), sum = room[0];
}
static void end(void) { (void)deeper; END }
"""
PLACES = {
    "loading": ("__attribute__((constructor)) static void go(void) { end(); }\n", ""),
    "arm_firmware": ("", ""),
    "start": ("static const char* go(const firmware_machine* m) { (void)m; end(); return 0; }", ""),
    "step": ("", "if (in->measured->tick == TICK) end();"),
    "end": ("__attribute__((destructor)) static void go(void) { end(); }\n", ""),
    "atexit": ("", "if (in->measured->tick == 0) atexit(end);"),
}


# In a process without ROS: exit() waits for threads of its middleware, which a fork leaves behind.
RUNS = """
import sys
from arm_emulator.cli.command_line import main
table, *libraries = sys.argv[1:]
for library in libraries:
    sys.argv = ["", "run", "three_axis", "--servo", library, "--targets", table]
    try:
        main()
    except SystemExit as end:
        print("exit code", end.code, flush=True)
"""


def test_a_library_that_ends_the_process_is_reported_with_its_tick(
    build: Callable[..., Path], tmp_path: Path
) -> None:
    """One line, and an exit code that is not 0; at a tick, and (in full) wherever its code runs."""
    (tmp_path / "table.csv").write_text(NO_TABLE)
    cases = [
        (place, how, tick)
        for place in some(["step", *PLACES], 1)
        for tick, how in enumerate(ENDS, random.Random(place).randrange(1800))
        # An end of the process in its usual place is harmless.
        if place not in ("end", "atexit") or "0" not in ENDS[how]
    ]
    libraries = []
    for place, how, tick in cases:
        before, body = PLACES[place]
        text = '#include "firmware.h"\n' + HEADERS.replace("END", how) + before
        made = code(body.replace("TICK", str(tick)), "go" if place == "start" else "0")
        if place == "arm_firmware":
            made = made.replace("  static const", "  end();\n  static const")
        libraries.append(build(text + made, "-w", "-D_GNU_SOURCE"))
    words = [sys.executable, "-c", RUNS, tmp_path / "table.csv", *libraries]
    done = subprocess.run(
        list(map(str, words)),
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=300, check=True,
    )  # fmt: skip
    reported = re.split(r"exit code (.*)\n", done.stdout)
    for (place, how, tick), printed, exit_code in zip(
        cases, reported[::2], reported[1::2], strict=False
    ):
        where = {
            "step": f", tick {tick}: step must return",
            "loading": ": file must be loaded by the system",
            "end": ": what runs at its end must return",
            "atexit": ": what runs at its end must return",
        }.get(place, f": {place} must return")
        line = rf"mine_\d+\.so{where}, got {ENDS[how]}\n"
        last = printed.splitlines(keepends=True)[-1]
        assert re.fullmatch(line, last) and exit_code == "2", (place, exit_code, printed)
        assert printed == last or place in ("end", "atexit"), printed
    assert len(reported) == 2 * len(cases) + 1, "every run has ended"


def test_a_library_that_does_not_return_is_reported_and_ends_with_ctrl_c(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(guarded, "LOOK", 0.05)
    monkeypatch.setattr(guarded, "REPORT_STALL", 0.1)

    def work(progress: CData) -> int:
        progress.doing, progress.loop.tick = Doing.STEP, 12
        while True:
            time.sleep(1.0)

    threading.Timer(0.6, signal.raise_signal, [signal.SIGINT]).start()
    with pytest.raises(KeyboardInterrupt):
        guarded.guarded("mine.so", work)
    printed = capfd.readouterr().err
    assert printed == (
        "mine.so, tick 12: step has not returned for 0.1 s; Ctrl-C ends it\n"
        "mine.so, tick 12: ended by a signal\n"
    )


def test_a_library_cut_short_is_refused(build: Callable[..., Path], tmp_path: Path) -> None:
    rng, body = np.random.default_rng(17), build().read_bytes()
    for _ in range(20):
        (tmp_path / "mine.so").write_bytes(body[: int(rng.integers(len(body) - 100))])
        with pytest.raises(Refusal, match=r"^mine.so: file must be a shared library"):
            Firmware(tmp_path / "mine.so")


def test_the_command_reports_and_lasts_as_long_as_its_table(
    build: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    table = tmp_path / "table.csv"
    table.write_text(NO_TABLE)
    arguments = ("run", "three_axis", "--targets", table)
    printed = []
    for more in (("--servo", build()), ()):
        exit_code, out, err = command(monkeypatch, capfd, *arguments, *more)
        assert (exit_code, err) == (0, ""), err
        lines = out.splitlines()
        assert lines[0].startswith("scene three_axis: 2 s of logical time in "), out
        assert [line.split()[0] for line in lines[1:]] == ["real-time", "tool", "energy"], out
        printed.append(lines[2:])
    assert printed[0] == printed[1], "tool and energy, of the library and of our servo"
    for words, more in (
        ("run: --servo must come with --targets", ["--servo", build()]),
        ("run: --displacement must stand without", ["--targets", table, "--displacement", 0, 0, 0]),
        ("run: seconds must be at least", ["--targets", table, "--seconds", "nan"]),
        ("run: seconds must be less than", ["--targets", table, "--seconds", "1e10"]),
    ):
        exit_code, out, err = command(monkeypatch, capfd, "run", "three_axis", *more)
        assert (exit_code, out, err.count("\n")) == (2, "", 1) and err.startswith(words), err


def test_the_template_builds_with_its_makefile(tmp_path: Path) -> None:
    if shutil.which("make") is None or shutil.which("cc") is None:
        pytest.skip("no make, or no cc")
    folder = shutil.copytree(FOLDER / "template", tmp_path / "mine")
    lines = (folder / "mine.c").read_text().splitlines()
    assert len(lines) <= 45, "short enough to be read at once"
    words = ["make", f"ARM_EMULATOR={ROOT}", "CFLAGS=-O2 -Werror"]
    done = subprocess.run(
        words, cwd=folder, capture_output=True, text=True, check=False, env=os.environ
    )
    assert done.returncode == 0, done.stderr
    assert "real-time factor" in done.stdout, done.stdout


@pytest.mark.parametrize("stops", some([1, 400], 0))
def test_a_debugger_changes_no_bit(stops: int, build: Callable[..., Path], tmp_path: Path) -> None:
    """Stopped in the first step, and 400 steps later; what is printed at the end is the same."""
    if shutil.which("gdb") is None:
        pytest.skip("no gdb")
    (tmp_path / "table.csv").write_text("t,waist,shoulder,elbow\n0,0.1,0.5,0.8\n0.5,0,0.4,0.9\n")
    words = [sys.executable, "-m", "arm_emulator", "run", "three_axis"]
    words += ["--servo", str(build("", "-g")), "--targets", str(tmp_path / "table.csv")]
    orders = ["set breakpoint pending on", "break step", "run", f"continue {stops}"]
    orders += ["print in->time", "delete", "continue"]
    gdb = ["gdb", "-batch", *(word for order in orders for word in ("-ex", order)), "--args"]
    reported = [
        subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout
        for command in (words, [*gdb, *words])
    ]
    assert f"= {stops * 1_000_000}" in reported[1], "logical time in the step [ns]"
    ends = [
        [line for line in text.splitlines() if line[:4] in ("tool", "ener")] for text in reported
    ]
    assert len(ends[0]) == 2 and ends[0] == ends[1], "tool and energy at the end"
