"""The binary of a unit for Windows, made by a cross compiler."""

import shutil
import tempfile
from pathlib import Path

from arm_emulator.extension.base import Refusal
from arm_emulator.extension.compiler import Unit, compute_fingerprint, run_compiler

COMPILERS = ("x86_64-w64-mingw32-g++-posix", "x86_64-w64-mingw32-g++")
# Windows aligns the stack for vectors of two numbers, and GCC counts on more for wider ones.
TARGET = "x86-64-v2"
NOT_THERE = {"-fPIC", "-fvisibility=hidden", "-Wl,-Bsymbolic"}  # of another file format
OWN = ("-static", "-s", "-Wl,--no-insert-timestamp")  # equal sources make equal files


def compile_for_windows(unit: Unit) -> bytes:
    """Return a unit as a library for 64-bit Windows that needs nothing beside the system's own.

    Raises:
        Refusal: there is no compiler, or it fails.
    """
    compiler = next(filter(shutil.which, COMPILERS), None)
    if compiler is None:
        raise Refusal(
            "fmu",
            "--windows",
            "find a cross compiler on the path",
            "none of " + ", ".join(COMPILERS),
            "install one (Debian, Ubuntu: g++-mingw-w64-x86-64)",
        )
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        (folder / "machine.cpp").write_text(unit.source, encoding="utf-8")
        (folder / "unit.cpp").write_text(unit.beside, encoding="utf-8")
        built = folder / "unit.dll"
        command = [
            compiler,
            *(flag for flag in unit.flags if flag not in NOT_THERE),
            *OWN,
            f"-march={TARGET}",
            f"-DARM_FINGERPRINT={compute_fingerprint(unit)}",
            *(f"-I{folder}" for folder in unit.folders),
            *(str(folder / name) for name in ("machine.cpp", "unit.cpp")),
            "-o",
            str(built),
        ]
        run_compiler(command, folder, unit.where, f"{unit.part} for Windows")
        return built.read_bytes()
