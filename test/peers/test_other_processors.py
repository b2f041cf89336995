"""A processor of another kind, emulated by qemu, computes the bits of this one.

It goes on from states that were saved here, too.
"""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from draws import some
from portable_bits import drawings

from arm_emulator import Plant
from arm_emulator.toolchain.flags import SHARED
from arm_emulator.toolchain.unit import compute_fingerprint
from arm_emulator_fleet import Fleet
from arm_emulator_fleet.unit import build_fleet_unit

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
    unit, N = build_fleet_unit(scene), len(scene.joints)
    rng = np.random.default_rng(11)
    commands = rng.uniform(-3.0, 3.0, (ROWS, ARMS, N))
    values = np.array([number.value for number in scene.varied] * ARMS)
    (tmp_path / "unit.cpp").write_text(unit.source)
    flags = [level if flag == "-O3" else flag for flag in unit.flags if flag not in SHARED]
    includes = [f"-I{folder}" for folder in unit.folders]
    includes += [f"-I{folder / 'boundary'}" for folder in unit.folders]
    client = tmp_path / "client"
    flags.append(f"-DARM_FINGERPRINT={compute_fingerprint(unit)}")
    command = [COMPILER, *flags, "-static", *includes, str(CLIENT), str(tmp_path / "unit.cpp")]
    built = subprocess.run([*command, "-o", client], capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr

    def there(commands: np.ndarray, *state: Path) -> list[list[int]]:
        step, varied = scene.integrator.dt, len(scene.varied)
        sizes = [N, ARMS, len(commands), STEPS, step, scene.steps_per_period, varied]
        arrays = [np.array(sizes), values, np.tile(scene.start, ARMS), commands.ravel()]
        (tmp_path / "given").write_bytes(np.concatenate(arrays).tobytes())
        run = [EMULATOR, str(client), str(tmp_path / "given"), *map(str, state)]
        done = subprocess.run(run, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{done.returncode} {done.stderr}"
        return [[int(word, 16) for word in line.split()] for line in done.stdout.splitlines()]

    plant, fleet = Plant(scene), Fleet(scene, ARMS)
    here: list[list[int]] = []
    for k, row in enumerate(commands):
        if k == ROWS // 2:
            (tmp_path / "saved").write_bytes(fleet.save())
        plant.advance(row[0], STEPS)
        fleet.advance(row, STEPS)
        own, all_arms = plant.state, fleet.state
        numbers = np.concatenate([own.q, own.v, all_arms.q.ravel(), all_arms.v.ravel()]) + 0.0
        here.append(numbers.view(np.uint64).tolist())
    assert there(commands) == here
    assert there(commands[ROWS // 2 :], tmp_path / "saved") == here[ROWS // 2 :], "from its state"
    assert np.abs(fleet.state.q - scene.start).max() > 0.01, "it moved"
