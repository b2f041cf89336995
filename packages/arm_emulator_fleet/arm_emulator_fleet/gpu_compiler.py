"""Compilation of kernels for cards of NVIDIA: clang makes PTX, ptxas makes code of one card.

clang needs nothing of NVIDIA for it. The driver compiles PTX when it loads it; ptxas, of the wheel
nvidia-cuda-nvcc-cu12 or of the toolkit, does that ahead of time.
"""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path

from arm_emulator.extension.base import Refusal
from arm_emulator.extension.compiler import (
    SHARED_FLAGS,
    Unit,
    UnitCompiler,
    compile_file,
    list_definitions,
    load_file,
    read_command,
    run_compiler,
)
from arm_emulator.extension.machine import Scene
from arm_emulator_fleet.unit import build_card_units

VARIABLE = "ARM_EMULATOR_CLANG"
OLDEST = 19  # clang
NAMES = (*(f"clang++-{version}" for version in range(OLDEST, OLDEST + 10)), "clang++")
# Cards from Volta on, that code may be compiled for ahead of time.
ARCHITECTURES = tuple(
    f"sm_{number}" for number in (70, 72, 75, 80, 86, 87, 89, 90, 100, 103, 120, 121)
)
# Products and sums are as they are written: PTX has `mul.rn` and `add.rn`, which the driver and
# ptxas do not contract.
FLAGS = (
    *"-x cuda --cuda-device-only -nocudainc -nocudalib -S".split(),
    *"-Xclang -fcuda-allow-variadic-functions".split(),
)
OF_LIBRARIES = (*SHARED_FLAGS, "-fvisibility=hidden", "-pthread")
PARALLEL = "--split-compile"  # of ptxas
QUICK = "--Ofast-compile"
WAIT = 30.0  # s, for a line about a compiler


def load_ptx(unit: Unit, architecture: str) -> bytes:
    """Return kernels as PTX, from the cache if they are there.

    Args:
        unit: their sources; its flags are those for the processor.
        architecture: of the card, as sm_90; PTX is for this or for an older one, if the compiler
            does not know this.

    Raises:
        Refusal: there is neither a sound cached file nor clang 19 or later, or it fails.
    """
    return load_file(_build_gpu_unit(unit, architecture), architecture, CLANG)


def load_cubin(unit: Unit, architecture: str) -> bytes:
    """Return kernels as code of one card, from the cache if they are there.

    Args:
        unit: see `load_ptx`.
        architecture: see there.

    Raises:
        Refusal: there is neither a sound cached file nor clang and ptxas, or one of them fails.
    """
    return load_file(_build_gpu_unit(unit, architecture), architecture, PTXAS)


def compile_for_card(unit: Unit, architecture: str, folder: Path | None = None) -> list[Path]:
    """Compile kernels ahead of their first use: to PTX, and where ptxas is, to code of the card.

    Args:
        unit: see `load_ptx`.
        architecture: one of `ARCHITECTURES`.
        folder: folder for copies; None: only the cache.

    Returns:
        Paths of the files.

    Raises:
        Refusal: the architecture is unknown, a compiler is missing or fails, or no folder is
            writable.
    """
    if architecture not in ARCHITECTURES:
        valid = ", ".join(ARCHITECTURES)
        raise Refusal("compile", "device", "be an architecture of cards", architecture, valid)
    unit = _build_gpu_unit(unit, architecture)
    compilers = [CLANG, PTXAS] if has_ptxas() else [CLANG]
    return [compile_file(unit, architecture, compiler, folder) for compiler in compilers]


def compile_scene_for_card(scene: Scene, architecture: str, folder: Path | None) -> list[Path]:
    """Compile the kernels of a scene's fleets, see `compile_for_card`.

    Raises:
        Refusal: see there; or no device advances the scene.
    """
    return [
        file
        for unit in build_card_units(scene)
        for file in compile_for_card(unit, architecture, folder)
    ]


def find_clang() -> list[str]:
    """Return the command of the compiler for cards: $ARM_EMULATOR_CLANG, or clang on the path.

    Raises:
        Refusal: none was found, or the variable is no command.
    """
    named = read_command(VARIABLE)
    for words in [named] if named else [[name] for name in NAMES]:
        if shutil.which(words[0]):
            return words
    raise Refusal(
        "arm_emulator",
        "compiler for cards",
        f"be on the path, clang {OLDEST} or later",
        named[0] if named else f"none of {NAMES[0]} to {NAMES[-2]}, {NAMES[-1]}",
        f"install clang-{OLDEST}, or set {VARIABLE}",
    )


def find_ptxas() -> list[str]:
    """Return the command of ptxas: of NVIDIA's wheel, or on the path.

    Raises:
        Refusal: none was found.
    """
    wheels = importlib.util.find_spec("nvidia")
    for folder in (wheels and wheels.submodule_search_locations) or ():
        for file in sorted(Path(folder).glob("*/bin/ptxas")):
            return [str(file)]
    if shutil.which("ptxas"):
        return ["ptxas"]
    remedy = "pip install nvidia-cuda-nvcc-cu12"
    raise Refusal("arm_emulator", "ptxas", "be installed or on the path", "none", remedy)


def has_ptxas() -> bool:
    """Whether `find_ptxas` finds it."""
    try:
        return bool(find_ptxas())
    except Refusal:
        return False


def is_assembled_quickly(ptx: bytes) -> bool:
    """Whether kernels do without the fastest code: arm_is_assembled_quickly of their source."""
    return re.search(rb"arm_is_assembled_quickly = 1;", ptx) is not None


def _build_gpu_unit(unit: Unit, architecture: str) -> Unit:
    flags = tuple(flag for flag in unit.flags if flag not in OF_LIBRARIES)
    return replace(
        unit,
        name=f"{unit.name}-{architecture}",
        flags=(*FLAGS, *flags),
        about=f"{unit.about} for {architecture}",
        saves_as=unit.saves_as or unit,
    )


def _build_ptx(command: list[str], unit: Unit, architecture: str, scratch: Path) -> bytes:
    target = _choose_target(tuple(command), unit.where, architecture)
    source, result = scratch / "unit.cu", scratch / "unit.ptx"
    source.write_text(unit.source, encoding="utf-8")
    words = [*command, *unit.flags, f"--cuda-gpu-arch={target}", *list_definitions(unit)]
    run_compiler([*words, str(source), "-o", str(result)], scratch, unit.where, unit.part)
    return _read_result(result, command[0], unit, b".version", "PTX")


def _build_cubin(command: list[str], unit: Unit, architecture: str, scratch: Path) -> bytes:
    source, result = scratch / "unit.ptx", scratch / "unit.cubin"
    ptx = load_file(unit, architecture, CLANG)
    source.write_bytes(ptx)
    words = [*command, "--fmad=false", f"-arch={architecture}"]
    options = _ask_compiler(tuple(command), unit.where, "--help")
    if PARALLEL in options:  # since CUDA 12
        words.append(f"{PARALLEL}=0")  # a thread on each core
    if is_assembled_quickly(ptx) and QUICK in options:
        words.append(f"{QUICK}=min")
    words += [str(source), "-o", str(result)]
    run_compiler(words, scratch, unit.where, unit.part)
    return _read_result(result, command[0], unit, b"\x7fELF", "a cubin")


CLANG = UnitCompiler("ptx", find_clang, lambda: bool(read_command(VARIABLE)), _build_ptx)
PTXAS = UnitCompiler("cubin", find_ptxas, lambda: False, _build_cubin)


def _read_result(file: Path, compiler: str, unit: Unit, mark: bytes, kind: str) -> bytes:
    content = file.read_bytes() if file.is_file() else b""
    if mark not in content:
        rule = f"make {kind}, though it reports no error"
        raise Refusal(unit.where, f"compiler {compiler}", rule, f"{len(content)} bytes of other")
    return content


@cache
def _choose_target(command: tuple[str, ...], where: str, architecture: str) -> str:
    """Return the newest architecture up to a card's that clang knows; newer cards take its PTX."""
    about = _ask_compiler(command, where, "--version")
    version = re.search(r"clang version (\d+)", about)
    if version is None or int(version[1]) < OLDEST:
        lines = about.strip().splitlines()[:1]
        remedy = f"install clang-{OLDEST}, or set {VARIABLE}"
        rule = f"be clang {OLDEST} or later for cards"
        raise Refusal(
            where, f"compiler {command[0]}", rule, lines[0] if lines else "nothing", remedy
        )
    text = _ask_compiler(command, where, "--target=nvptx64-nvidia-cuda", "--print-supported-cpus")
    targets = [int(number) for number in re.findall(r"^\s*sm_(\d+)$", text, re.M)]
    card = re.fullmatch(r"sm_(\d+)[af]?", architecture)
    fitting = [number for number in targets if card and number <= int(card[1])]
    if not fitting:
        valid = ", ".join(f"sm_{number}" for number in targets)
        rule = "be an architecture that the compiler knows"
        raise Refusal(where, "card", rule, architecture, valid)
    return f"sm_{max(fitting)}"


def _ask_compiler(command: tuple[str, ...], where: str, *words: str) -> str:
    """Return the words that a compiler writes about itself."""
    try:
        done = subprocess.run(
            [*command, *words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=WAIT,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise Refusal(where, f"compiler {command[0]}", f"answer {words[-1]}", error) from None
    return done.stdout.decode(errors="replace")
