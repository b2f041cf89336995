"""The kernels of a fleet by other compilers: ptxas for cards, clang for the processor."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from draws import some
from fleet_pairs import Pair
from test_fleet_step import LOCATED
from test_gpu_compiler import needs_clang

from arm_emulator import Scene, load_scene
from arm_emulator.extension.compiler import Unit
from arm_emulator_fleet import device_core, unit
from arm_emulator_fleet.device import Device, Module
from arm_emulator_fleet.device_core import STACK, STACK_WITH_EVENTS
from arm_emulator_fleet.gpu_compiler import find_ptxas, has_ptxas, is_assembled_quickly, load_ptx
from arm_emulator_fleet.load_kernels import load_parts
from arm_emulator_fleet.unit import ALL_KERNELS, FOLDER, SMOOTH_KERNEL, build_kernels_unit

pytest_plugins = ["devices"]

needs_ptxas = pytest.mark.skipif(not has_ptxas(), reason="pip install nvidia-cuda-nvcc-cu12")
CLANG = next(filter(shutil.which, ("clang++-19", "clang++")), None)
CARDS = 90, 70, 75, 80, 86, 89, 100, 120
ROBOTS = "three_axis", "ur5", "panda"
PARTS = ALL_KERNELS, SMOOTH_KERNEL
KERNELS = {
    part: re.findall(r"ARM_KERNEL\((\w+)\) \{", (FOLDER / part).read_text()) for part in PARTS
}
# In the order of ptxas: a function, its own stack; then of a kernel registers and all of its stack.
FUNCTION = re.compile(r"Function properties for (\w+)\n\s+(\d+) bytes stack frame")
CUMULATIVE = re.compile(r"(\d+) bytes cumulative stack size")


@needs_clang
@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("robot", some(ROBOTS, 1))
def test_kernels_call_nothing_that_a_card_has_not(robot: str, part: str) -> None:
    """The kernel of smooth steps has no code of events; where they exist, the others are assembled
    quickly."""
    ptx = load_ptx(build_kernels_unit(load_scene(robot), kernels=part), "sm_90")
    text = ptx.decode()
    assert sorted(re.findall(r"\.visible \.entry (\w+)\(", text)) == sorted(KERNELS[part])
    assert not re.findall(r"^\s*\.extern .*", text, re.M)
    has_events = robot != "three_axis"
    assert ("EventLocation" in text) == (has_events and part == ALL_KERNELS)
    assert is_assembled_quickly(ptx) == (has_events and part == ALL_KERNELS)


@needs_clang
@needs_ptxas
@pytest.mark.parametrize("number", CARDS)
@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("robot", some(ROBOTS, 1))
def test_no_thread_needs_more_stack_than_it_gets(
    robot: str, part: str, number: int, tmp_path: Path
) -> None:
    source = tmp_path / "kernels.ptx"
    unit = build_kernels_unit(load_scene(robot), kernels=part)
    source.write_bytes(load_ptx(unit, f"sm_{number}"))
    words = [*find_ptxas(), "-v", "--fmad=false", f"-arch=sm_{number}", source, "-o", "/dev/null"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    report = done.stdout + done.stderr
    assert done.returncode == 0, report
    frames = {name: int(size) for name, size in FUNCTION.findall(report)}
    assert frames.keys() >= set(KERNELS[part]), "a kernel of which ptxas reports nothing"
    stacks = [*frames.values(), *map(int, CUMULATIVE.findall(report))]
    small = robot == "three_axis" or part == SMOOTH_KERNEL
    stack_limit = STACK if small else STACK_WITH_EVENTS
    least = 0 if robot == "three_axis" and part == SMOOTH_KERNEL else 1000
    assert least <= max(stacks) <= stack_limit, (
        f"{robot} on sm_{number}: {sorted(stacks)[-5:]} bytes"
    )


@pytest.fixture
def located() -> Scene:
    return load_scene("three_axis", overrides=LOCATED)


@pytest.mark.skipif(CLANG is None, reason="clang is not installed")
def test_loops_by_clang_give_the_same_bits(located: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    def load(device: Device, units: list[Unit]) -> list[Module]:
        with monkeypatch.context() as context:
            context.setenv("CXX", str(CLANG))
            return load_parts(device, units)

    monkeypatch.setattr(device_core, "load_parts", load)
    judge(located)


@pytest.mark.parametrize("lanes", [4])
def test_threads_of_more_arms_give_the_same_bits(
    located: Scene, monkeypatch: pytest.MonkeyPatch, lanes: int
) -> None:
    monkeypatch.setattr(unit, "LANES_OF_THREAD", lanes)
    assert judge(located).fleets[1].lanes == lanes


def judge(scene: Scene) -> Pair:
    """Compare every kind of steps with lanes that the usual compiler has made."""
    pair = Pair(scene, 11, "processor", 1)
    for action in (pair.aim, pair.follow, pair.exchange, pair.step, pair.run, pair.throw):
        for _ in range(3):
            action()
            pair.assert_alike(action.__name__)
    pair.saved = [fleet.save() for fleet in pair.fleets]  # compilers choose the signs of zeros
    pair.restore()
    pair.step()
    pair.assert_alike("restore")
    return pair
