"""A processor of another kind, emulated by qemu, computes the bits of this one."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from draws import some
from portable_bits import drawings

from arm_emulator import Fleet, Plant
from arm_emulator.build.flags import SHARED
from arm_emulator.machine.compiler import fleet_unit

ROWS, STEPS, ARMS = 50, 40, 3
CLIENT = Path(__file__).parents[1] / "portable_run.cpp"
COMPILER, EMULATOR = "aarch64-linux-gnu-g++", "qemu-aarch64"
MISSING = [name for name in (COMPILER, EMULATOR) if shutil.which(name) is None]


@pytest.mark.skipif(bool(MISSING), reason=f"{MISSING}: apt install g++-aarch64-linux-gnu qemu-user")
@pytest.mark.parametrize("level", some(("-O3", "-O1"), 1))
@pytest.mark.parametrize("name", some(("sensed", "mixture 0", "ur5", "panda", "mixture 5"), 2))
def test_an_aarch64_computes_the_bits_of_this_processor(
    name: str, level: str, tmp_path: Path
) -> None:
    scene = drawings(tmp_path)[name]({})
    unit, N = fleet_unit(scene), len(scene.joints)
    rng = np.random.default_rng(11)
    commands = rng.uniform(-3.0, 3.0, (ROWS, ARMS, N))
    values = np.array([one.value for one in scene.varied] * ARMS)
    sizes = [N, ARMS, ROWS, STEPS, scene.integrator.dt, scene.steps_per_period, len(scene.varied)]
    given = [np.array(sizes, np.float64), values, np.tile(scene.start, ARMS), commands.ravel()]
    (tmp_path / "given").write_bytes(np.concatenate(given).tobytes())
    (tmp_path / "unit.cpp").write_text(unit.source)
    flags = [level if flag == "-O3" else flag for flag in unit.flags if flag not in SHARED]
    includes = [f"-I{folder}" for folder in unit.folders]
    includes += [f"-I{folder / 'boundary'}" for folder in unit.folders]
    client = tmp_path / "client"
    command = [COMPILER, *flags, "-static", *includes, str(CLIENT), str(tmp_path / "unit.cpp")]
    built = subprocess.run([*command, "-o", client], capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    done = subprocess.run(
        [EMULATOR, client, tmp_path / "given"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr

    plant, fleet = Plant(scene), Fleet(scene, ARMS)
    for k, (row, line) in enumerate(zip(commands, done.stdout.splitlines(), strict=True)):
        plant.advance(row[0], STEPS)
        fleet.advance(row, STEPS)
        own, all_arms = plant.state, fleet.state
        here = np.concatenate([own.q, own.v, all_arms.q.ravel(), all_arms.v.ravel()]) + 0.0
        there = np.array([int(word, 16) for word in line.split()], np.uint64)
        assert here.view(np.uint64).tolist() == there.tolist(), f"row {k}"
    assert np.abs(fleet.state.q - scene.start).max() > 0.01, "it moved"
