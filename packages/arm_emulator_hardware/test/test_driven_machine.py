"""A machine with the loops of its drives in C++: loops, readings, power, refusals, equal bits."""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from draws import with_slow
from test_campaign_machine_faults import SENT

from arm_emulator import load_scene, load_servo_config
from arm_emulator.cli.commands.servo_header import make_servo_data_unit
from arm_emulator.machine.plant.compiler import compile_ahead
from arm_emulator.servo.c import FOLDER
from arm_emulator.servo.servo_numbers import make_servo_numbers
from arm_emulator.tick.c import FOLDERS
from arm_emulator.toolchain.compile_unit import compile_units
from arm_emulator.toolchain.compiler_command import find_compiler

ROOT = Path(__file__).resolve().parents[3]
SOURCES = ROOT / "packages/arm_emulator_hardware/src"
CHECKS = "-g -O1 -fsanitize=address,undefined -fno-sanitize-recover=all"
FLAGS = "-std=c++17 -Wall -Wextra -Wpedantic -Werror".split()
SERVO = load_servo_config(ROOT / "config/servo/three_axis.yaml")
NUMBERS = make_servo_numbers(SERVO.joints, SERVO.period, SERVO.supply_voltage)
N = len(load_scene("three_axis").joints)
READING = ("q", "v", "effort", "current", "counts", "true_q", "true_v", "true_effort")


def compile_client(at: Path, source: Path, checks: str = CHECKS) -> None:
    """Compile a client of machines in this folder."""
    includes = [f"-I{one}" for one in (SOURCES, *FOLDERS, FOLDER)]
    files = [str(source), str(SOURCES / "driven_machine.cpp")]
    words = [*FLAGS, *checks.split(), *includes, *files, "-ldl", "-o", str(at / "client")]
    done = subprocess.run([*find_compiler(), *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The client with what it needs."""
    at = tmp_path_factory.mktemp("driven")
    compile_ahead(load_scene("three_axis", SENT["set"]), "native", at)
    compile_units([make_servo_data_unit("three_axis")], "native", at)
    compile_client(at, Path(__file__).with_name("driven_machine.cpp"))
    return at


def run(folder: Path, period: int, scene: str = "three_axis", cycles: int = 10_000) -> list[str]:
    words = [str(folder / "client"), str(folder / scene), str(period), str(cycles), "1"]
    free = {name: value for name, value in os.environ.items() if name != "LD_PRELOAD"}
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=free)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def readings(line: str) -> dict[str, np.ndarray]:
    values = np.array([float(word) for word in line.split()[1:]]).reshape(N, len(READING))
    return dict(zip(READING, values.T, strict=True))


@pytest.mark.parametrize("period", with_slow([1_000_000, 4_000_000], 1))
def test_each_loop_obeys_its_command(folder: Path, period: int) -> None:
    lines = run(folder, period)
    assert lines == run(folder, period)  # to the last bit
    worst, moved, held, early, late, effort = lines[:6]
    # A motion of 0.3 rad in 1 s, peak speed 0.56 rad/s. A servo without the speed of its target
    # would lag by 0.56 / Kp = 19 mrad; gears wind up by some tenths of a mrad.
    assert float(worst.split()[1]) < 2e-3
    assert np.allclose(readings(moved)["true_q"], 0.3, atol=1e-3)
    count = NUMBERS["count_angle"] * NUMBERS["ratio"]  # at the link
    assert np.all(np.abs(readings(held)["q"] - 0.3) <= 1.5 * count)
    gone = readings(late)["true_q"] - readings(early)["true_q"]
    assert np.allclose(gone, 0.4 * 0.5, rtol=0.01)  # of 0.5 s at 0.4 rad/s
    # The current sensor and the motor's data sheet, not the servo's own estimate, judge the effort.
    seen = readings(effort)["current"] * NUMBERS["torque_constant"] / NUMBERS["ratio"]
    assert np.allclose(seen, 10.0, rtol=0.05)
    assert lines[6:9] == ["without power 1", "wrong 0 1", "bounds 1 1"]
    # The disc slipped by 10 rad of the motor: the servo holds what it measures.
    slipped = readings(lines[9])
    assert np.allclose(slipped["q"], 0.0, atol=1.5 * count.max())
    assert np.allclose(np.abs(slipped["true_q"]), [0.0, 0.0, 10.0 * NUMBERS["ratio"][2]], atol=1e-3)


def test_switches_of_loops_drives_and_power_leave_every_reading_finite(folder: Path) -> None:
    *_, shaken, end, last, _, _, _ = run(folder, 1_000_000)
    assert shaken.startswith("bad 0 cut ") and int(shaken.split()[-1]) > 100
    assert all(np.all(np.isfinite(values)) for values in readings(end).values())
    assert last == "time 10000000000"


def test_refusals_are_a_line(folder: Path) -> None:
    valid = "valid: waist, shoulder, elbow"
    line = f"three_axis: joint must be one of the arm, got no_such_joint; {valid}"
    assert run(folder, 1_000_000, cycles=1)[-1] == line
    unknown, beyond = run(folder, 1_000_000, cycles=1)[-3:-1]
    assert "command_interface must be `power` or a number that the scene varies, got" in unknown
    assert "valid: faults.elbow.command_late, faults.elbow.encoder_slips" in unknown
    assert "faults.elbow.command_late must be within 0 to 16, got 99" in beyond
    (period,) = run(folder, 1_500_000)
    assert "update_rate must give a multiple of the servo period 1000000 ns, got 1500000" in period
    (absent,) = run(folder, 1_000_000, "nothing")
    assert "nothing: scene must be FOLDER/NAME after" in absent and "got no nothing-*.so" in absent
    (twin,) = (file for file in folder.glob("three_axis-servo-*.so"))
    (folder / "three_axis-servo-0123456789.so").write_bytes(twin.read_bytes())
    (twice,) = run(folder, 1_000_000)
    (folder / "three_axis-servo-0123456789.so").unlink()
    assert "scene must be compiled once in its folder" in twice
    assert all("\n" not in line for line in (period, absent, twice))
