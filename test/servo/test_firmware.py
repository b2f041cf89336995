"""Control code in C: our servo as portable C, a user's library in the loop, a table of targets."""

import dataclasses
import itertools
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from draws import some
from in_process import in_process
from network import bits_of
from own_firmware import (
    NAMES,
    NO_TABLE,
    ROOT,
    SCENE,
    SERVO,
    WARNINGS,
    N,
    builder,
    code,
    command,
    compile_c,
    random_table,
    row_at,
    run_c,
)
from sensor_msgs.msg import JointState
from visits import random_visits

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.session.firmware import Firmware
from arm_emulator.machine.session.session import Session
from arm_emulator.runs.servo_step import ServoStep
from arm_emulator.runs.table_run import TableRun, load_table_run
from arm_emulator.runs.target_table import load_target_table
from arm_emulator.runs.timeline import Timeline
from arm_emulator.servo.c import FOLDER
from arm_emulator.servo.servo_arm import ServoArm, Target
from arm_emulator.servo.servo_law import servo_law
from arm_emulator.tick.c import FOLDERS
from arm_emulator.toolchain.c_header import make_pointer
from arm_emulator.toolchain.compiler_command import find_compiler
from arm_emulator.toolchain.flags import C_FLAGS

MORE_WARNINGS = ["-Wconversion", "-Wdouble-promotion"]


MOTION_TICKS = round(SERVO.motion_period / SERVO.period)


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    return builder(tmp_path_factory.mktemp("built"))


def states_of(run: TableRun, ticks: int) -> dict[int, bytes]:
    session, states = run.session, {}
    while True:
        measured = session.measured
        states[session.tick] = bits_of(measured.encoder_counts, measured.current)
        if session.tick == ticks:
            return states
        run.advance(1)


@pytest.mark.parametrize("level", some(["-O2", "-O0", "-Os", "-O3"], 2))
@pytest.mark.parametrize("kind", ["double", "float"])
def test_the_servo_needs_no_library(kind: str, level: str, tmp_path: Path) -> None:
    """No C library, no heap: nothing is asked for that the object does not have."""
    if shutil.which("nm") is None:
        pytest.skip("no nm")
    words = ["-x", "c", "-std=c99", level, "-ffreestanding", "-nostdlib"]
    words += [*WARNINGS, *MORE_WARNINGS, "-c"]
    words += ["-DSERVO_FLOAT"] if kind == "float" else []
    compiled = tmp_path / "servo.o"
    run_c([*find_compiler(), *words, str(FOLDER / "servo.c"), "-o", str(compiled)])
    lacks = subprocess.run(["nm", "-u", str(compiled)], capture_output=True, text=True, check=True)
    assert lacks.stdout == "", "symbols that it lacks"


def test_all_of_our_c_compiles_without_a_warning(tmp_path: Path) -> None:
    ours = [*FOLDERS[0].glob("*.c"), ROOT / "arm_emulator/runs/servo_step.c"]
    for number, source in enumerate(ours):
        compile_c(tmp_path / f"{number}.so", *MORE_WARNINGS, "-c", str(source))


def test_a_servo_that_has_measured_nothing_gives_no_voltage() -> None:
    """For any target the output is 0 V: the positions of the motors are unknown."""
    drives, law = ServoArm(SERVO), servo_law()
    arm, voltage = drives.servo.arm, np.full(N, np.nan)
    drives.set_target(Target(np.ones(N)))
    law.servo_command(arm, True, make_pointer(voltage))
    np.testing.assert_array_equal(voltage, np.zeros(N), err_msg="before the first measurement")
    drives.take_measurement(0, [0] * N, [0.0] * N)
    drives.set_target(Target(np.ones(N)))
    assert (drives.compute_commands(powered=True) > 0.0).all(), "after it, towards the target"
    drives.reset()
    law.servo_command(arm, True, make_pointer(voltage))
    np.testing.assert_array_equal(voltage, np.zeros(N), err_msg="after a reset")


def test_fast_math_is_refused_by_the_compiler(tmp_path: Path) -> None:
    for flag in ("-ffast-math", "-ffinite-math-only"):
        command = [*find_compiler(), *C_FLAGS, flag, "-c", str(FOLDER / "servo.c")]
        command += ["-o", str(tmp_path / "servo.o")]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode != 0 and "compile without -ffast-math" in done.stderr, flag


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
    session, drives = Session(SCENE, "lockstep", "first_answer"), ServoArm(SERVO)
    states = {}
    for tick in range(ticks + 1):
        measured = session.measured
        states[tick] = bits_of(measured.encoder_counts, measured.current)
        drives.take_measurement(
            session.logical_ns, measured.encoder_counts, measured.current, measured.applied
        )
        drives.set_target(Target(np.array(row_at(rows, tick))))
        session.offer(tick, NAMES, drives.compute_commands(session.powered).tolist())
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
    for name, second in (
        ("our servo, no library", states_of(of_servo, ticks)),
        ("Python in every period", by_hand(rows, ticks)),
        ("nodes in lock-step", node_states(rows, ticks)),
    ):
        wrong = [tick for tick in range(ticks + 1) if reported[tick] != second[tick]]
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
        run = TableRun(SCENE, table, ServoStep(ServoArm(config), order))
        run.advance(200)
        saved.add(run.session.plant.save())
    assert len(saved) == 1, "machines after 200 ticks, by the servo's order of joints"


@pytest.mark.parametrize("seed", some(range(8), 2))
def test_single_precision_moves_the_arm_as_double(
    seed: int, build: Callable[..., Path], tmp_path: Path
) -> None:
    """At rest both stand in the target's count; on the way they may be some counts apart.

    Angles of a motor up to 100 rad are rounded to 4e-6 rad, a thousandth of a count. So now and
    then a count is seen a tick earlier or later. Each moves the observed speed by a share of
    omega_gain, 0.2 counts per ms here. The loops correct this within some 10 ms: a few counts, 3.2
    in 12 draws.
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
    command(monkeypatch, capfd, *arguments)  # compiles what the cache lacks
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


@pytest.mark.parametrize("kind", ["library", "our servo"])
def test_any_tick_of_a_table_run_can_be_visited(
    kind: str, build: Callable[..., Path], tmp_path: Path
) -> None:
    rng = np.random.default_rng(31)
    random_table(rng, tmp_path / "table.csv", 20)
    # Two libraries of one file would share their variables.
    number = itertools.count()

    def fresh() -> TableRun:
        library = None
        if kind == "library":
            library = tmp_path / f"mine_{next(number)}.so"
            shutil.copy(build(), library)
        return load_table_run("three_axis", tmp_path / "table.csv", library)[0]

    random_visits(fresh, rng)


def test_a_library_that_remembers_elsewhere_has_no_timeline(build: Callable[..., Path]) -> None:
    pure = "static double sum; sum += sin(in->time); out->joint[0].value = sum;"
    Timeline(TableRun(SCENE, None, Firmware(build(f"#include <math.h>\n{code(pure)}"))))
    for step, named in (
        ("static int* p; if (!p) p = calloc(1, 4); out->joint[0].value = ++*p;", "calloc"),
        ("out->joint[0].value = rand() % 2;", "rand"),
        ("static __thread int k; out->joint[0].value = ++k;", "variables of threads"),
    ):
        run = TableRun(SCENE, None, Firmware(build(f"#include <stdlib.h>\n{code(step)}")))
        run.advance(2)
        with pytest.raises(Refusal, match=rf"nothing but its variables.*{named}"):
            Timeline(run)


def test_only_states_that_the_same_run_has_saved_are_restored(tmp_path: Path) -> None:
    random_table(np.random.default_rng(3), tmp_path / "table.csv")
    first, second = (
        load_table_run("three_axis", tmp_path / "table.csv", None)[0] for _ in range(2)
    )
    with pytest.raises(Refusal, match="of the same run"):
        first.restore(second.save())
