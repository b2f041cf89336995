"""Vectors are read from and written to memory that has the alignment they ask for.

A cast from numbers to a vector asks for more than the numbers' type states: whether a caller's
array has it is luck of the stack, and of the compiler. One test refuses such casts; the other lets
UBSan check each address at run time, with both compilers.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from test_compilers import CLANGS, level_of, units

# Casts are refused by g++ alone: clang's -Wcast-align does not look at vectors.
CASTS = ["-fsyntax-only", "-Werror=cast-align", "-Wcast-align=strict", "-DARM_FINGERPRINT=1u"]

# Without optimisation, which compiles a fleet several times as fast: the checks are the same. An
# address that is not aligned ends the process.
CHECKED = """#!/usr/bin/env bash
exec {compiler} "${{@/#-O3/-O0}}" -fsanitize=alignment {trap}
"""
TRAPS = {
    "clang": "-fsanitize-trap=alignment",
    "g++": "-fsanitize-undefined-trap-on-error",
}

# Steps whose events are located, of one machine, of a fleet in lanes and of one lane alone;
# derivatives; equations; drives of a field bus and the servo's loops in them.
RUN = """
import numpy as np

from arm_emulator import Plant, load_scene, load_servo_config, sensitivities
from arm_emulator_fleet import Fleet
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import ETHERCAT

dry = {"joints.*.friction": {"coulomb": 2.0, "viscous": 1.0}, "integrator.events": "located"}
scene = load_scene("three_axis", dry)
rows = np.random.default_rng(0).uniform(-12.0, 12.0, (40, 3))
plant = Plant(scene)
plant.run(rows, scene.steps_per_period)
plant.links.mass_matrix
fleet = Fleet(scene, 10)
fleet.run(rows[:, None, :] * np.linspace(0.3, 1.0, 10)[None, :, None], 2 * scene.steps_per_period)
sensitivities(scene, rows, ["joints.*.friction.coulomb"])
drives = Drives(Plant(scene), load_servo_config("config/servo/three_axis.yaml"), ETHERCAT)
drives.period(5)
print("done")
"""


@pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")
def test_no_cast_asks_for_more_alignment_than_the_type_states(tmp_path: Path) -> None:
    level = level_of("g++")
    for number, unit in enumerate(units(tmp_path)):
        folder = tmp_path / f"{number}_{unit.name}"
        folder.mkdir()
        texts = {"unit.cpp": unit.source, "beside.cpp": unit.beside}
        files = [folder / name for name, text in texts.items() if text]
        for file in files:
            file.write_text(texts[file.name])
        flags = [flag for flag in unit.flags if not flag.startswith(("-shared", "-Wl"))]
        folders = [f"-I{folder}" for folder in unit.folders]
        command = ["g++", *flags, *level, *CASTS, *folders, *map(str, files)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{unit.name}: {done.stderr[:2000]}"


@pytest.mark.parametrize("compiler", ["g++", *CLANGS])
def test_all_addresses_are_aligned(compiler: str, tmp_path: Path) -> None:
    checked = tmp_path / "checked"
    kind = "clang" if "clang" in compiler else "g++"
    checked.write_text(CHECKED.format(compiler=compiler, trap=TRAPS[kind]))
    checked.chmod(0o755)
    done = subprocess.run(
        [sys.executable, "-X", "faulthandler", "-c", RUN],
        capture_output=True, text=True, check=False,
        env={**os.environ, "CXX": str(checked), "ARM_EMULATOR_CACHE": str(tmp_path / "cache")},
    )  # fmt: skip
    assert done.returncode == 0 and done.stdout == "done\n", done.stderr[-2000:]
