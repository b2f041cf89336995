"""The binary of a unit for Windows: what it has and needs, and its motion under Wine."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from fmu_client import OK, Fmu, Instance

from arm_emulator.base.refusal import Refusal
from arm_emulator_fmu.commands.fmu import write_unit
from arm_emulator_fmu.windows import COMPILERS, compile_for_windows

TEST = Path(__file__).resolve().parent
SOURCES = TEST.parents[1] / "arm_emulator_fmu"
TARGET = "x86-64-v2"
AS_LINUX = 1e-9  # rad, after a second: sines of another C library

needs_mingw = pytest.mark.skipif(
    not any(map(shutil.which, COMPILERS)),
    reason="mingw is not installed (Debian, Ubuntu: g++-mingw-w64-x86-64)",
)


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> Fmu:
    folder = tmp_path_factory.mktemp("unit")
    write_unit("three_axis", out=folder / "arm.fmu", target=TARGET, windows=True)
    return Fmu(folder / "arm.fmu", folder / "unpacked")


def dll_of(unit: Fmu) -> Path:
    return Path(unit.binary._name).parents[1] / "x86_64-windows" / "three_axis.dll"


@needs_mingw
def test_the_library_has_the_functions_and_needs_the_system_only(unit: Fmu) -> None:
    done = subprocess.run(
        ["x86_64-w64-mingw32-objdump", "-p", str(dll_of(unit))],
        capture_output=True,
        text=True,
        check=True,
    )
    declared = re.findall(r"\b(fmi3[A-Z]\w+)\(", (SOURCES / "fmi3.h").read_text())
    exported = set(re.findall(r"\] (fmi3\w+)$", done.stdout, re.M))
    assert {"fmi3DoStep", "fmi3GetFloat64", "fmi3SetFMUState", *declared} <= exported, "functions"
    needed = set(re.findall(r"DLL Name: (\S+)", done.stdout))
    assert needed == {"KERNEL32.dll", "msvcrt.dll"}, "libraries that it needs"


@needs_mingw
@pytest.mark.skipif(not shutil.which("wine"), reason="wine is not installed (Debian: wine wine64)")
def test_it_moves_under_wine_as_under_linux(unit: Fmu, tmp_path: Path) -> None:
    importer = tmp_path / "importer.exe"
    subprocess.run(
        ["x86_64-w64-mingw32-gcc", "-std=gnu99", "-O1", "-Wall", f"-I{SOURCES}",
         str(TEST / "windows_importer.c"), "-o", str(importer)],
        check=True,
    )  # fmt: skip
    joints = unit.size("truth.q")
    names = ("command", "truth.q")
    references = [unit.variables[name].attrib["valueReference"] for name in names]
    token = unit.root.attrib["instantiationToken"]
    done = subprocess.run(
        ["wine", str(importer), f"Z:{dll_of(unit)}", token, *references, str(joints)],
        capture_output=True, text=True, check=False, timeout=300,
        env={"WINEPREFIX": str(tmp_path / "wine"), "WINEDEBUG": "-all", "PATH": "/usr/bin:/bin",
             "HOME": str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    printed_rows = [
        [float.fromhex(word) for word in row.split()] for row in done.stdout.splitlines()
    ]
    assert len(printed_rows) == 60, "a row for each step"
    instance = Instance(unit)
    instance.start()
    for k, (time, *q) in enumerate(printed_rows):
        assert instance.set("command", [(k + j) % 7 - 3.0 for j in range(joints)]) == OK, (
            instance.printed
        )
        instance.time = k / 60.0
        assert instance.step(1.0 / 60.0) == OK, instance.printed
        assert time == pytest.approx(instance.time, abs=1e-12), "time"
        assert np.abs(np.array(q) - instance.get("truth.q")).max() < AS_LINUX, f"angles at {time} s"


def test_without_a_cross_compiler_it_names_the_missing_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from arm_emulator.machine.scene.scene import load_scene
    from arm_emulator_fmu.unit import make_unit
    from arm_emulator_fmu.variables import list_variables

    scene = load_scene("three_axis")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(Refusal, match=r"--windows must find a cross compiler .*g\+\+-mingw-w64"):
        compile_for_windows(make_unit(scene, list_variables(scene), "3")[0])
