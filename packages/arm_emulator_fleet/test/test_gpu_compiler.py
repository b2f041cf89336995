"""Kernels become PTX, cached by content; a compiler that cannot make it is refused in one line."""

import re
import shutil
import struct
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from draws import some
from fake_compiler import fake_compiler

from arm_emulator import Refusal, load_scene
from arm_emulator.cli.commands.compile import compile_scene
from arm_emulator.extension.compiler import ARITHMETIC, SHARED_FLAGS, Unit, compute_fingerprint
from arm_emulator.toolchain.flags import CPP_FLAGS
from arm_emulator.toolchain.library_cache import CACHE_VARIABLE, LIBRARY, SEAL_SIZE
from arm_emulator_fleet import gpu_compiler
from arm_emulator_fleet.device_array import convert_to_device_array
from arm_emulator_fleet.gpu_compiler import (
    ARCHITECTURES,
    NAMES,
    VARIABLE,
    compile_for_card,
    compile_scene_for_card,
    load_cubin,
    load_ptx,
)
from arm_emulator_fleet.load_kernels import load_kernels
from arm_emulator_fleet.processor_device import ProcessorDevice

pytest_plugins = ["devices"]

KERNELS = Path(__file__).with_name("device_kernels.cpp")
HAS_CLANG = any(map(shutil.which, NAMES))
needs_clang = pytest.mark.skipif(not HAS_CLANG, reason="clang 19 or later is not installed")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "cache"
    monkeypatch.setenv(CACHE_VARIABLE, str(folder))
    monkeypatch.delenv(VARIABLE, raising=False)
    gpu_compiler._choose_target.cache_clear()
    return folder


def make_unit(more: str = "") -> Unit:
    flags = (*CPP_FLAGS, "-ffinite-math-only", "-fvisibility=hidden", "-pthread")
    source = KERNELS.read_text() + more
    return Unit("test_kernels", source, flags, (), (), "test", "kernels of a test", "the kernels")


def name_clang(monkeypatch: pytest.MonkeyPatch, folder: Path, does: str, version: str) -> None:
    """Let a script be clang; it states its version and the cards it knows."""
    cards = "\\tsm_50\\n\\tsm_70\\n\\tsm_90\\n\\tsm_90a\\n"
    about = f'case "$*" in *--version*) echo "{version}"; exit;; '
    about += f'*--print-supported-cpus*) printf "{cards}"; exit;; esac\n'
    folder.mkdir(exist_ok=True)
    monkeypatch.setenv(VARIABLE, fake_compiler(folder, about + does))


@needs_clang
@pytest.mark.parametrize("architecture", some(ARCHITECTURES, 3))
def test_kernels_become_ptx_for_a_card(architecture: str) -> None:
    text = load_ptx(make_unit(), architecture).decode()
    target = re.search(r"^\.target sm_(\d+)$", text, re.M)
    assert target and int(target[1]) <= int(architecture.removeprefix("sm_"))
    assert re.findall(r"\.visible \.entry (\w+)\(", text) == ["scale"]
    assert re.search(r"\.visible \.global .* offsets\[24\]", text)
    assert ".param .u64" in text, "the number of threads"


@needs_clang
def test_products_and_sums_are_not_contracted() -> None:
    """The driver may contract `mul` and `add`, but not `mul.rn` and `add.rn`."""
    text = load_ptx(make_unit(), "sm_90").decode()
    instructions = set(re.findall(r"\b((?:mul|add|sub|fma|mad)\.\S*f64)", text))
    assert instructions == {"mul.rn.f64", "add.rn.f64"}


@needs_clang
def test_the_second_use_compiles_nothing(
    cache: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    first = load_ptx(make_unit(), "sm_90")
    assert re.search(r"^compiling kernels of a test for sm_90 with \S*clang\S* \.\.\. [\d.]+ s$",
                     capsys.readouterr().err, re.M)  # fmt: skip
    (file,) = [file for file in cache.iterdir() if file.suffix == ".ptx"]
    assert LIBRARY.fullmatch(file.name), "`cache clear` and the bound on its size find it"
    assert load_ptx(make_unit(), "sm_90") == first == file.read_bytes()[:-SEAL_SIZE]
    monkeypatch.setenv("PATH", str(tmp_path))
    assert load_ptx(make_unit(), "sm_90") == first, "a machine without clang uses it"
    assert capsys.readouterr().err == ""
    for load in (
        lambda: load_ptx(make_unit(), "sm_80"),
        lambda: load_ptx(make_unit("//"), "sm_90"),
    ):
        with pytest.raises(Refusal, match="compiler for cards must be on the path"):
            load()


@needs_clang
def test_a_spoiled_file_is_compiled_again(cache: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = load_ptx(make_unit(), "sm_90")
    (file,) = [file for file in cache.iterdir() if file.suffix == ".ptx"]
    file.write_bytes(file.read_bytes().replace(b"mul.rn", b"add.rn"))
    capsys.readouterr()
    assert load_ptx(make_unit(), "sm_90") == first
    assert "is not used: it is cut short, changed" in capsys.readouterr().err


@needs_clang
def test_files_are_compiled_ahead_into_a_folder(tmp_path: Path) -> None:
    file = compile_for_card(make_unit(), "sm_90", tmp_path / "into")[0]
    assert file.parent == tmp_path / "into" and file.suffix == ".ptx"
    assert file.read_bytes()[:-SEAL_SIZE] == load_ptx(make_unit(), "sm_90")


@needs_clang
def test_an_error_in_the_kernels_is_a_line() -> None:
    with pytest.raises(Refusal, match=r"test: compiler \S+ must compile the kernels, got exit code "
                                      r"1: unit.cu:\d+:\d+: error: .*no_such_name"):  # fmt: skip
        load_ptx(make_unit("\nint x = no_such_name;\n"), "sm_90")


@needs_clang
def test_kernels_restore_states_that_the_processor_has_saved() -> None:
    """The fingerprint of a machine does not depend on the device."""
    unit = make_unit('\nextern "C" { unsigned long long mark = ARM_FINGERPRINT; }\n')
    source = unit.source.replace("unsigned", "__attribute__((device)) unsigned")
    text = load_ptx(replace(unit, source=source, saves_as=unit), "sm_90").decode()
    mark = re.search(r" mark = (-?\d+);", text)
    assert mark and int(mark[1]) % 2**64 == int(compute_fingerprint(unit).rstrip("u"), 16)


def test_the_flags_are_those_of_the_processor_but_for_libraries() -> None:
    flags = gpu_compiler._build_gpu_unit(make_unit(), "sm_90").flags
    assert "-ffp-contract=off" in flags and "-O3" in flags and ARITHMETIC.split()[1] in str(flags)
    assert not set(flags) & {*SHARED_FLAGS, "-fvisibility=hidden", "-pthread"}


def test_no_clang(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(Refusal) as refused:
        load_ptx(make_unit(), "sm_90")
    line = "arm_emulator: compiler for cards must be on the path, clang 19 or later, got none of "
    line += "clang++-19 to clang++-28, clang++; valid: install clang-19, or set ARM_EMULATOR_CLANG"
    assert str(refused.value) == line


@pytest.mark.parametrize(
    "version", ["Debian clang version 18.1.8", "g++ 14.2.0", "Ubuntu clang version 9", ""]
)
def test_a_compiler_that_is_too_old(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, version: str
) -> None:
    name_clang(monkeypatch, tmp_path / "bin", "exit 9", version)
    line = f"must be clang 19 or later for cards, got {version or 'nothing'}; valid: install clang"
    with pytest.raises(Refusal, match=re.escape(line)):
        load_ptx(make_unit(), "sm_90")


@pytest.mark.parametrize(
    ("does", "message"),
    [
        ("exit 3", "must compile the kernels, got exit code 3"),
        ("kill -9 $$", "must compile the kernels, got ended by SIGKILL"),
        ("true", "must make PTX, though it reports no error, got 0 bytes of other"),
        ('echo nothing > "$out"', "must make PTX, though it reports no error, got 8 bytes"),
    ],
)
def test_a_compiler_that_makes_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cache: Path, does: str, message: str
) -> None:
    name_clang(monkeypatch, tmp_path / "bin", does, "clang version 19.1.7")
    with pytest.raises(Refusal, match=message):
        load_ptx(make_unit(), "sm_90")
    assert not list(cache.glob("*.ptx"))


@pytest.mark.parametrize("command", ["'", "no_such_compiler -x"])
def test_a_variable_that_names_no_compiler(monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    monkeypatch.setenv(VARIABLE, command)
    with pytest.raises(Refusal, match=r"(ARM_EMULATOR_CLANG|compiler for cards) must"):
        load_ptx(make_unit(), "sm_90")


@pytest.mark.parametrize(
    ("card", "target"),
    [("sm_90", 90), ("sm_90a", 90), ("sm_89", 70), ("sm_121", 90), ("sm_50", 50)],
)
def test_newer_cards_get_ptx_of_an_older_architecture(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, card: str, target: int
) -> None:
    name_clang(monkeypatch, tmp_path / "bin", 'echo ".version $*" > "$out"', "clang version 20.1")
    assert f"--cuda-gpu-arch=sm_{target} " in load_ptx(make_unit(), card).decode()


@pytest.mark.parametrize("card", ["sm_37", "sm_", "gfx90a", "", "sm_90; rm"])
def test_a_card_that_the_compiler_does_not_know(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, card: str
) -> None:
    name_clang(monkeypatch, tmp_path / "bin", 'echo ".version" > "$out"', "clang version 20.1")
    with pytest.raises(Refusal, match=r"test: card must be .*; valid: sm_50, sm_70, sm_90$"):
        load_ptx(make_unit(), card)


@pytest.mark.parametrize("card", ["sm_91", "sm_60", "90", "compute_90", "native"])
def test_an_unknown_architecture_is_not_compiled_for(card: str) -> None:
    with pytest.raises(Refusal, match="compile: device must be an architecture of cards, got"):
        compile_for_card(make_unit(), card)


def test_the_kernels_of_a_scene_are_compiled_ahead(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    does = 'for w; do case "$w" in *.cu) (echo ".version $*"; cat "$w") > "$out";; esac; done'
    name_clang(monkeypatch, tmp_path / "bin", does, "clang version 19.1")
    monkeypatch.setattr(gpu_compiler, "has_ptxas", lambda: False)
    more = tmp_path / "more.ptx"
    points = {
        "campaign": SimpleNamespace(load=lambda: lambda *arguments: [more]),
        "fleet": SimpleNamespace(load=lambda: compile_scene_for_card),
    }
    monkeypatch.setattr("arm_emulator.base.packages.find_entries", lambda group: points)
    for ahead in ("compile_ahead", "compile_units"):  # what is for the processor
        monkeypatch.setattr(f"arm_emulator.cli.commands.compile.{ahead}", lambda *arguments: [])
    folder = tmp_path / "into"
    assert compile_scene("three_axis", device="sm_90", into=folder) == 0
    files = [Path(line) for line in capsys.readouterr().out.splitlines()]
    assert sorted(folder.iterdir()) == sorted(files)
    for file, kernels in zip(files, ("fleet_kernels", "advance_to_event"), strict=True):
        text = file.read_bytes()
        assert file.suffix == ".ptx" and b"--cuda-gpu-arch=sm_90" in text
        assert f'#include "{kernels}.hpp"'.encode() in text
    monkeypatch.setattr("arm_emulator.cli.commands.compile.UNITS", "none")
    monkeypatch.setattr(
        "arm_emulator.cli.commands.compile.load_all",
        lambda group: [] if group == "none" else [point.load() for point in points.values()],
    )
    assert compile_scene("three_axis", device="sm_90", into=folder, packages=True) == 0
    assert capsys.readouterr().out == "".join(f"{file}\n" for file in (more, *files))
    with pytest.raises(Refusal, match="compile: device must be an architecture of cards, got sm_9"):
        compile_scene("three_axis", device="sm_9")
    two = {"threads": 2, "integrator.scheme": "paper"}
    threads = load_scene("three_axis", overrides=two)
    with pytest.raises(Refusal, match="threads must be 1 on a device: its arms are its threads"):
        compile_scene_for_card(threads, "sm_90", None)


def test_no_ptxas(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(gpu_compiler.importlib.util, "find_spec", lambda name: None)
    line = "arm_emulator: ptxas must be installed or on the path, got none; "
    with pytest.raises(Refusal, match=f"^{line}valid: pip install nvidia-cuda-nvcc-cu12$"):
        load_cubin(make_unit(), "sm_90")
    assert not gpu_compiler.has_ptxas()


@pytest.mark.parametrize("about", ["--split-compile <N> --Ofast-compile <N>", "nothing"])
@pytest.mark.parametrize("quick", [0, 1])
def test_ptxas_gets_the_ptx_of_the_kernels(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, about: str, quick: int
) -> None:
    """And adds to no product: without --fmad=false it might contract PTX of others."""
    text = f".version 7.8\n.global .align 4 .u32 arm_is_assembled_quickly = {quick};"
    name_clang(monkeypatch, tmp_path / "bin", f"echo '{text}' > \"$out\"", "clang version 19.1")
    does = r'printf "\177ELF%s " "$*" > "$out"; for w; do case "$w" in *.ptx) cat "$w" >> "$out";; esac; done'  # noqa: E501
    does = f'case "$*" in --help) echo "{about}"; exit;; esac; {does}'
    ptxas = fake_compiler(tmp_path / "bin", does)
    monkeypatch.setattr(gpu_compiler, "find_ptxas", lambda: [ptxas])
    monkeypatch.setattr(gpu_compiler, "PTXAS", replace(gpu_compiler.PTXAS, find=lambda: [ptxas]))
    cubin = load_cubin(make_unit(), "sm_120")
    knows = about != "nothing"
    words = b"--fmad=false -arch=sm_120 " + b"--split-compile=0 " * knows
    words += b"--Ofast-compile=min " * (knows and quick)
    assert cubin.startswith(b"\x7fELF" + words + b"/") and b".version 7.8\n" in cubin
    kinds = [file.suffix for file in compile_for_card(make_unit(), "sm_120")]
    assert kinds == [".ptx", ".cubin"]


@needs_clang
def test_the_same_source_is_loaded_by_either_device(
    cards: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    unit = replace(make_unit(), more=("scale", "take"))
    module = load_kernels(ProcessorDevice(1), unit)
    array = convert_to_device_array(module.device, np.ones(3))
    module.launch("scale", 3, struct.pack("Qdq", array.pointer, 2.0, 1))
    assert array.numpy().tolist() == [3.5, 3.25, 3.125]
    monkeypatch.setattr(gpu_compiler, "PTXAS", replace(gpu_compiler.PTXAS, find=find_nothing))
    loaded: list[bytes] = []
    card = cards.open()
    monkeypatch.setattr(card, "load", loaded.append)
    load_kernels(card, unit)
    assert loaded == [load_ptx(unit, "sm_90")], "the driver compiles it where there is no ptxas"
    monkeypatch.setattr(
        gpu_compiler, "load_cubin", lambda *arguments: b"cubin for " + arguments[1].encode()
    )
    load_kernels(card, unit)
    assert loaded[1:] == [b"cubin for sm_90"]


def find_nothing() -> list[str]:
    raise Refusal("test", "ptxas", "be installed", "none")
