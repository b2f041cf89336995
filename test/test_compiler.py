"""The scene's library: compiled once, cached by content, and what happens where that fails."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from machines import random_chain

from arm_emulator.refusal import Refusal
from emulator_node.compiler import (
    CORE,
    FLAGS,
    compile_ahead,
    library_of,
    scene_unit,
)
from emulator_node.cxx import find_compiler
from emulator_node.library_cache import CACHE_VARIABLE
from emulator_node.scene import load_scene

READY = (
    "from emulator_node.scene import load_scene; from emulator_node.plant import Plant;"
    "print(Plant(load_scene('three_axis')).t)"
)


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "cache"
    monkeypatch.setenv(CACHE_VARIABLE, str(folder))
    return folder


def no_compiler(monkeypatch: pytest.MonkeyPatch, empty: Path) -> None:
    monkeypatch.setenv("PATH", str(empty))
    monkeypatch.delenv("CXX", raising=False)


def test_second_use_compiles_nothing(
    cache: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    library_of(load_scene("three_axis"))
    assert "compiling scene three_axis (3 joints) ... " in capsys.readouterr().err
    no_compiler(monkeypatch, tmp_path)
    library_of(load_scene("three_axis"))
    assert capsys.readouterr().err == ""


def test_the_step_is_no_part_of_the_library_but_physics_is(cache: Path) -> None:
    for overrides in ({}, {"integrator.dt": 1e-5}, {"joints.waist.start": 1.0}):
        library_of(load_scene("three_axis", overrides=overrides))
    assert len(list(cache.glob("*.so"))) == 1
    library_of(load_scene("three_axis", overrides={"joints.elbow.gear.stiffness": 2e4}))
    assert len(list(cache.glob("*.so"))) == 2


@pytest.mark.parametrize("joints", [4, 14])
@pytest.mark.parametrize(
    ("scheme", "threads"),
    [("paper", 1), ("implicit", 2), ("rosenbrock", 1), ("extrapolated", 1), ("extrapolated", 2)],
)
def test_the_core_compiles_without_a_warning(
    scheme: str, threads: int, joints: int, tmp_path: Path
) -> None:
    integrator = {"scheme": scheme, "dt": 1e-4}
    scene = random_chain(tmp_path, 3, joints, integrator=integrator, threads=threads)
    source = tmp_path / "unit.cpp"
    source.write_text(scene_unit(scene))
    flags = [flag for flag in FLAGS if flag not in ("-O3", "-shared")]  # -O1 for the time it takes
    warnings = ["-O1", "-c", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{CORE}"]
    command = [*find_compiler(), *flags, *warnings, str(source), "-o", str(tmp_path / "unit.o")]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (built.returncode, built.stderr) == (0, "")


def test_without_a_compiler_it_says_what_to_do(
    cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    no_compiler(monkeypatch, tmp_path)
    with pytest.raises(Refusal, match=r"C\+\+ compiler must be on the path.*arm_emulator compile"):
        library_of(load_scene("three_axis"))


def test_a_library_compiled_ahead_serves_a_machine_without_a_compiler(
    cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    scene = load_scene("three_axis")
    compile_ahead(scene, "x86-64", cache)
    no_compiler(monkeypatch, tmp_path)
    library_of(scene)
    with pytest.raises(Refusal, match="target must be known, got z80; valid: native, x86-64-v4"):
        compile_ahead(scene, "z80", cache)


def test_a_failing_compiler_is_told(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CXX", "false")
    with pytest.raises(Refusal, match="compiler false must compile the scene's core"):
        library_of(load_scene("three_axis"))
    assert list(cache.glob("*.so")) == []


def test_two_processes_at_once_share_one_compilation(cache: Path) -> None:
    command = [sys.executable, "-c", READY]
    processes = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    said = [process.communicate(timeout=600) for process in processes]
    assert [out for out, _ in said] == ["0.0\n"] * 3
    assert sum("compiling" in err for _, err in said) == 1
    assert len(list(cache.glob("*.so"))) == 1


def test_a_read_only_cache_falls_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The user's cache cannot be made: libraries go to a folder of ours in /tmp."""
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    blocked = tmp_path / "a_file"
    blocked.touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    done = subprocess.run(
        [sys.executable, "-c", READY], capture_output=True, text=True, timeout=600, check=True
    )
    assert done.stdout == "0.0\n"
    assert len(list((tmp_path / f"arm_emulator-{os.getuid()}").glob("*.so"))) == 1


def test_no_place_for_a_cache_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "a_file"
    blocked.touch()
    monkeypatch.setenv(CACHE_VARIABLE, str(blocked))
    with pytest.raises(Refusal, match=f"cache folder must be writable.*set {CACHE_VARIABLE}"):
        library_of(load_scene("three_axis"))
