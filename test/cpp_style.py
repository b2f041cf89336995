"""Names and habits of the C++: clang-tidy over every library that is compiled, by .clang-tidy.

`make tidy` runs this file.
"""

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import clang_tidy

from arm_emulator.machine.plant.compiler import (
    build_equations_unit,
    build_machine_unit,
    build_real_time_unit,
)
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.toolchain.unit import Unit
from arm_emulator_fieldbus.ethercat import ethercat_unit
from arm_emulator_firmware.microcontroller import make_runner_unit
from arm_emulator_fleet.unit import build_fleet_unit
from arm_emulator_fmu.unit import VERSIONS, make_unit
from arm_emulator_fmu.variables import list_variables

ROOT = Path(__file__).resolve().parents[1]
LANGUAGE = "-std=c++20"
CLANG_TIDY = str(clang_tidy.get_executable("clang-tidy"))
VARIANTS: tuple[dict[str, object], ...] = (
    {},
    {"integrator.scheme": "extrapolated", "integrator.events": "located"},
    {"integrator.scheme": "paper", "threads": 2},
)


def units() -> Iterator[Unit]:
    """Yield what has C++ in it: of scenes, each kind of integration once."""
    scene = load_scene("three_axis")
    for variant in VARIANTS:
        yield build_machine_unit(load_scene("three_axis", variant))
    yield build_equations_unit(scene)
    yield build_fleet_unit(scene)
    yield build_real_time_unit()
    yield ethercat_unit()
    yield make_runner_unit()
    for version in VERSIONS:
        fmu, _ = make_unit(scene, list_variables(scene), version)
        yield replace(fmu, source=fmu.beside)


def main() -> int:
    """Return how many units there is something against."""
    bad = 0
    folder = ROOT / "out" / "tidy"  # below .clang-tidy
    folder.mkdir(parents=True, exist_ok=True)
    for unit in units():
        file = folder / f"unit_{unit.name}.cpp"  # units include files of their name
        file.write_text(unit.source, encoding="utf-8")
        command = [CLANG_TIDY, "--quiet", *sys.argv[1:], str(file), "--"]
        includes = [f"-I{folder.resolve()}" for folder in unit.folders]
        done = subprocess.run(
            [*command, LANGUAGE, *includes], check=False, capture_output=True, text=True
        )
        if done.returncode:
            bad += 1
            print(done.stdout, end="")
            print(f"clang-tidy: {unit.name} is not in the style of .clang-tidy", file=sys.stderr)
    return bad


if __name__ == "__main__":
    sys.exit(main())
