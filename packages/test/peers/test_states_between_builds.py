"""Code of one compiler goes on to the last bit from states and bags of that of another."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import test_causal_replay
from draws import some
from test_compilers import compilers

ROOT = Path(__file__).parents[3]
# It goes on from a saved machine, or saves one first, and prints where it comes to.
GO_ON = """
import pathlib, sys
import numpy as np
import arm_emulator.machine.plant.compiler as of_machines
from arm_emulator import Plant, load_scene
from arm_emulator.toolchain.compile_unit import compile_units
from machines import SENSED

way, target, level, file = *sys.argv[1:4], pathlib.Path(sys.argv[4])
of_machines.FLAGS = tuple(level if flag == "-O3" else flag for flag in of_machines.FLAGS)
scene = load_scene("three_axis", SENSED)
if target != "native":
    compile_units([of_machines.build_machine_unit(scene)], target, None)
plant = Plant(scene)
rows = np.random.default_rng(3).uniform(-10.0, 10.0, (2, 100, 3))
if way == "save":
    plant.run(rows[0], 10)
    file.write_bytes(plant.save())
else:
    plant.restore(file.read_bytes())
q = plant.run(rows[1], 10)
print(q.tobytes().hex(), np.asarray(plant.measured.current).tobytes().hex())
"""
CLANGS = compilers("clang++")
bag_of_a_network = test_causal_replay.bag
TAKEN_UP_BY = [
    (CLANGS[0] if CLANGS else "g++", "x86-64-v2", "-O1"),
    *((clang, "native", "-O3") for clang in CLANGS),
    *((compiler, "native", "-O3") for compiler in compilers("g++")),
]


def in_build(compiler: str, folder: Path, *words: str | Path) -> str:
    """Run Python with code of a compiler and return what it prints."""
    cache = folder / f"cache {compiler}"
    paths = os.pathsep.join([str(ROOT), str(ROOT / "test"), os.environ.get("PYTHONPATH", "")])
    env = os.environ | {"CXX": compiler, "ARM_EMULATOR_CACHE": str(cache), "PYTHONPATH": paths}
    command = [sys.executable, *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=env)
    assert done.returncode == 0, f"{compiler}: {done.stdout}{done.stderr}"
    return done.stdout


@pytest.mark.skipif(os.uname().machine != "x86_64", reason="targets of other processors")
@pytest.mark.parametrize(("compiler", "target", "level"), some(TAKEN_UP_BY, 1))
def test_a_saved_machine_goes_on_in_any_build(
    compiler: str, target: str, level: str, tmp_path: Path
) -> None:
    file = tmp_path / "saved"
    expected = in_build("g++", tmp_path, "-c", GO_ON, "save", "native", "-O3", file)
    assert in_build(compiler, tmp_path, "-c", GO_ON, "go on", target, level, file) == expected


@pytest.mark.parametrize("compiler", CLANGS)
def test_a_bag_of_another_build_is_equal_to_the_last_bit(compiler: str, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    ours = ("-m", "arm_emulator")
    in_build("g++", tmp_path, *ours, "run", "three_axis", "--seconds", "1", "--bag", bag)
    printed = in_build(compiler, tmp_path, *ours, "check-bag", bag)
    assert "equal to the last bit" in printed and "another arithmetic" not in printed, printed


@pytest.mark.parametrize("compiler", CLANGS)
def test_nodes_of_another_build_give_the_recorded_bits(
    compiler: str, bag_of_a_network: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CXX", compiler)
    monkeypatch.setenv("ARM_EMULATOR_CACHE", str(tmp_path))
    test_causal_replay.test_the_recorded_nodes_give_the_recorded_bits(bag_of_a_network)
    assert any(tmp_path.rglob("*.so")), "its own code"


@pytest.mark.parametrize("compiler", CLANGS)
def test_a_campaign_and_the_replay_of_its_run_have_the_same_bits(
    compiler: str, tmp_path: Path
) -> None:
    campaign = ("-m", "arm_emulator", "campaign", ROOT / "examples/campaign.yaml", "--json")
    results, bag = [], tmp_path / "bag"
    for build, options in (("g++", ("--bag", bag)), (compiler, ())):
        into = tmp_path / f"results {build}"
        output = in_build(
            build, tmp_path, *campaign, "--into", into, "--count", "10", "--workers", "1"
        )
        run = in_build(build, tmp_path, *campaign, "--into", into, "--replay", "3", *options)
        results.append((json.loads(output)["digest"], run))
    assert results[0] == results[1]
    printed = in_build(compiler, tmp_path, "-m", "arm_emulator", "check-bag", bag)
    assert "equal to the last bit" in printed and "another arithmetic" not in printed, printed
