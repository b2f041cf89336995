"""Libraries of control code, built for the tests."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from arm_emulator import Plant, load_scene, load_servo_config
from arm_emulator.cli.command_line import main
from arm_emulator.cli.commands.servo_header import write_header
from arm_emulator.runs.servo_step import make_servo_step_unit
from arm_emulator.servo.c import FOLDER
from arm_emulator.servo.servo_law import servo_law
from arm_emulator.tick.c import FOLDERS
from arm_emulator.toolchain.compile_unit import load_library
from arm_emulator.toolchain.compiler_command import find_compiler
from arm_emulator.toolchain.flags import C_FLAGS

ROOT = Path(__file__).resolve().parents[1]

SERVO = load_servo_config(ROOT / "config/servo/three_axis.yaml")

SCENE = load_scene("three_axis")

NAMES, N = SCENE.joint_names, len(SCENE.joints)

WARNINGS = "-Wall -Wextra -pedantic -Werror".split()


def compile_c(out: Path, *words: str) -> None:
    """Compile as our own C is compiled, and fail on any warning."""
    folders = [f"-I{folder}" for folder in (FOLDER, *FOLDERS, out.parent)]
    run_c([*find_compiler(), *C_FLAGS, *WARNINGS, *folders, *words, "-o", str(out)])


def run_c(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), "exit code and words of the compiler"


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


NO_TABLE = "t,waist,shoulder,elbow\n0,0,0.5,0.8\n1,0,0.5,0.8\n"


def command(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], *words: Any
) -> tuple[int, str, str]:
    """Run a command of ours in this process (a library of a user's in a child of it).

    Return its exit code and its prints, without those of first compilations.
    """
    Plant(SCENE), servo_law(), load_library(make_servo_step_unit())
    capfd.readouterr()
    monkeypatch.setattr(sys, "argv", ["arm_emulator", *map(str, words)])
    with pytest.raises(SystemExit) as end:
        main()
    printed = capfd.readouterr()
    return int(end.value.code or 0), printed.out, printed.err


def builder(folder: Path) -> Callable[..., Path]:
    """Return what builds the template with our servo's numbers, or other code, as a library."""
    (folder / "servo_joints.h").write_text(write_header("three_axis", NAMES, SERVO))
    built_files: dict[tuple[str, ...], Path] = {}

    def built(source: str = "", *flags: str) -> Path:
        if (source, *flags) not in built_files:
            file = folder / f"mine_{len(built_files)}.c"
            file.write_text(source or (FOLDER / "template/mine.c").read_text())
            library, objects = file.with_suffix(".so"), []
            for source_file in [file] if source else [file, FOLDER / "servo.c"]:
                objects.append(file.with_suffix(f".{source_file.stem}.o"))
                compile_c(objects[-1], *flags, "-c", str(source_file))
            run_c([*find_compiler(), "-shared", *map(str, objects), "-o", str(library)])
            built_files[source, *flags] = library
        return built_files[source, *flags]

    return built
