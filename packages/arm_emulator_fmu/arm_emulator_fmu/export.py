"""From a scene to a functional mock-up unit: a file that simulators load."""

import os
import platform
import re
import shlex
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

from arm_emulator.extension.base import Refusal, find_config_folder
from arm_emulator.extension.compiler import (
    CORE_FOLDER,
    TICK_FOLDERS,
    compile_bytes,
    compute_fingerprint,
)
from arm_emulator.extension.machine import Scene
from arm_emulator_fmu.model_description import (
    build_description,
    describe_model,
    describe_model_2,
)
from arm_emulator_fmu.names import make_identifier
from arm_emulator_fmu.page import write_page
from arm_emulator_fmu.unit import FOLDER, make_unit
from arm_emulator_fmu.variables import list_scalars, list_variables
from arm_emulator_fmu.windows import compile_for_windows

# That most machines have; "native" is faster, and gives other bits.
TARGET = "x86-64-v2" if platform.machine() == "x86_64" else "native"
PLATFORMS = {"3": f"{platform.machine()}-linux", "2": "linux64"}  # by the version of FMI
WINDOWS = {"3": "x86_64-windows", "2": "win64"}
_SOURCES = ("machine.cpp", "unit.cpp")
_NEEDED = b"""\
The binary for Linux needs libc, libm, libgcc_s and libstdc++ of GCC 7 or later, as every Linux with
programs in C++ has them. The binary for Windows, where there is one, needs the system's own only.
"""
_DATE = (1980, 1, 1, 0, 0, 0)  # so that equal scenes make equal files


def export(
    scene: Scene, out: Path, target: str = TARGET, version: str = "3", windows: bool = False
) -> None:
    """Write a scene's machine as a unit for co-simulation.

    Args:
        scene: the machine; its `varied` numbers become tunable parameters.
        out: the file, which ends in ``.fmu``.
        target: which processors its binary is for, see `compile_units`.
        version: of FMI, one of `unit.VERSIONS`; without arrays in FMI 2.
        windows: with a binary for 64-bit Windows, too.

    Raises:
        Refusal: another ending, a file that cannot be written, or no compiler.
    """
    if out.suffix != ".fmu":
        raise Refusal("fmu", "--out", "end in .fmu", out.name)
    listed = list_variables(scene) if version == "3" else list_scalars(scene)
    unit, token = make_unit(scene, listed, version)
    library = compile_bytes(unit, target)
    name = make_identifier(scene.name)
    options = shlex.join([*unit.flags, f"-march={target}"])
    definition = f"ARM_FINGERPRINT={compute_fingerprint(unit)}"
    command = f"g++ {options} -I. -D{definition} {' '.join(_SOURCES)} -o {name}.so"
    sources = dict(zip(_SOURCES, (unit.source, unit.beside), strict=True))
    sources |= _list_included(*sources.values())
    if version == "3":
        own = {
            "modelDescription.xml": describe_model(scene, listed, token),
            "sources/buildDescription.xml": build_description(scene, _SOURCES, options, definition),
        }
    else:
        own = {"modelDescription.xml": describe_model_2(scene, listed, token)}
    files = {
        **own,
        "documentation/index.html": write_page(scene, listed, command),
        "documentation/licenses/license.txt": (
            find_config_folder().parent / "LICENSE"
        ).read_bytes(),
        "documentation/externalDependencies.txt": _NEEDED,
        **{f"sources/{file}": text.encode() for file, text in sources.items()},
        f"binaries/{PLATFORMS[version]}/{name}.so": library,
    }
    if windows:
        files[f"binaries/{WINDOWS[version]}/{name}.dll"] = compile_for_windows(unit)
    try:
        _write_archive(out, files)
    except OSError as error:
        raise Refusal("fmu", f"file {out}", "be writable", error.strerror) from None


def _list_included(*sources: str) -> dict[str, str]:
    """Return the files that sources include, and those that they include, by name."""
    included: dict[str, str] = {}
    left = list(sources)
    while left:
        for name in re.findall(r'^ *# *include "([^"]+)"', left.pop(), re.M):
            if name not in included:
                file = next(
                    folder / name
                    for folder in (FOLDER, CORE_FOLDER, *TICK_FOLDERS)
                    if (folder / name).is_file()
                )
                included[name] = file.read_text(encoding="utf-8")
                left.append(included[name])
    return dict(sorted(included.items()))


def _write_archive(out: Path, files: Mapping[str, bytes]) -> None:
    """Write the archive beside its place, then move it there."""
    with tempfile.TemporaryDirectory(prefix=f"{out.name}.", dir=out.parent) as scratch:
        beside = Path(scratch) / out.name
        with zipfile.ZipFile(beside, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in files.items():
                zip_info = zipfile.ZipInfo(name, _DATE)
                zip_info.compress_type = zipfile.ZIP_DEFLATED
                zip_info.external_attr = 0o644 << 16
                archive.writestr(zip_info, content)
        os.replace(beside, out)
