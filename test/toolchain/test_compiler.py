"""The scene's library: compiled once, cached by content, and what happens where that fails."""

import contextlib
import ctypes.util
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from draws import some, with_slow
from fake_compiler import fake_compiler
from machines import random_chain

from arm_emulator import Refusal, load_scene
from arm_emulator.core import CORE
from arm_emulator.machine.plant.compiler import FLAGS, compile_ahead, load_machine
from arm_emulator.machine.plant.scene_unit import write_scene_unit
from arm_emulator.tick.c import tick_unit
from arm_emulator.toolchain import compile_unit, cxx
from arm_emulator.toolchain.compiler_command import find_compiler, identify_compiler
from arm_emulator.toolchain.flags import SHARED
from arm_emulator.toolchain.library_cache import CACHE_VARIABLE, SEAL_SIZE

READY = (
    "from arm_emulator.machine.scene.scene import load_scene;"
    "from arm_emulator.machine.plant.plant import Plant;"
    "print(Plant(load_scene('three_axis')).t)"
)


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "cache"
    monkeypatch.setenv(CACHE_VARIABLE, str(folder))
    return folder


@pytest.fixture
def quick_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that gives three_axis' library, or that of its periods, without the work."""
    for name, compiled in (
        ("made", load_machine(load_scene("three_axis"))),
        ("tick", compile_unit.load_library(tick_unit())),
    ):
        (tmp_path / name).write_bytes(Path(compiled.file).read_bytes()[:-SEAL_SIZE])
    of_ticks = 'grep -q tick.c "${out%.so}.cpp"'
    does = f"""
sleep 0.5
if {of_ticks}; then cp {tmp_path / "tick"} "$out"; else cp {tmp_path / "made"} "$out"; fi
"""
    monkeypatch.setenv("CXX", fake_compiler(tmp_path, does))


def compiled_in(cache: Path) -> list[Path]:
    """Return the files of a cache, except parsed headers."""
    return [file for file in cache.iterdir() if file.suffix != ".cdef"]


def no_compiler(monkeypatch: pytest.MonkeyPatch, empty: Path) -> None:
    monkeypatch.setenv("PATH", str(empty))
    monkeypatch.delenv("CXX", raising=False)


def test_second_use_compiles_nothing(
    quick_compiler: None,
    cache: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    load_machine(load_scene("three_axis"))
    printed = capsys.readouterr().err
    using = identify_compiler(find_compiler())
    assert f"compiling scene three_axis (3 joints) with {using} ... " in printed, printed
    no_compiler(monkeypatch, tmp_path)
    load_machine(load_scene("three_axis"))
    assert capsys.readouterr().err == "", "the second use prints nothing"


@pytest.mark.slow
def test_compilers_are_reported_apart(
    quick_compiler: None,
    cache: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """By the name that theirs stands for, and by options; unnamed, a library of others serves."""
    scene = load_scene("three_axis")
    compiler = os.environ["CXX"]
    second, link = tmp_path / "clang++-99", tmp_path / "c++"
    second.write_bytes(Path(compiler).read_bytes())
    second.chmod(0o755)
    link.symlink_to(second.name)
    compiles = {
        compiler: True,
        f"{compiler} -g": True,
        str(second): True,
        str(link): False,
        compiler + " ": False,
    }
    for command, expected in compiles.items():
        monkeypatch.setenv("CXX", command)
        load_machine(scene)
        printed = capsys.readouterr().err
        using = identify_compiler(find_compiler())
        first = f"compiling scene three_axis (3 joints) with {using}"
        assert printed.startswith(first) == expected, (command, printed)
    assert len(list(cache.glob("*.so"))) == 3, "libraries of one scene"
    monkeypatch.delenv("CXX")
    load_machine(scene)
    assert capsys.readouterr().err == "", "an unnamed compiler"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "serves"),
    [
        ("clang++-99", True),
        ("g++", True),
        ("x86_64-linux-gnu-g++-12", True),
        ("g++ -O0 -g", False),
        ("quick_cxx", False),
        ("ccache", False),
    ],
)
def test_a_library_of_options_or_of_a_wrapper_serves_who_names_it(
    command: str,
    serves: bool,
    quick_compiler: None,
    cache: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """It may be slow. Without a compiler it is better than none."""
    scene, actual = load_scene("three_axis"), os.environ["CXX"]
    name, *options = command.split()
    (tmp_path / "bin").mkdir()
    for program in (name, "c++"):
        (tmp_path / "bin" / program).write_text(f'#!/bin/sh\nexec {actual} "$@"\n')
        (tmp_path / "bin" / program).chmod(0o755)
    monkeypatch.setenv("CXX", shlex.join([str(tmp_path / "bin" / name), *options]))
    load_machine(scene)
    (first,) = cache.glob("*.so")
    assert load_machine(scene).file == str(first), "who names it"
    no_compiler(monkeypatch, tmp_path)
    assert load_machine(scene).file == str(first), "who has no compiler"
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:/usr/bin:/bin")
    capsys.readouterr()
    found = load_machine(scene).file
    assert (found == str(first)) == serves
    assert capsys.readouterr().err.startswith("compiling scene three_axis") == (not serves)


def test_the_step_is_no_part_of_the_library_but_physics_is(
    quick_compiler: None, cache: Path
) -> None:
    for overrides in ({}, {"integrator.dt": 1e-5}, {"joints.waist.start": 1.0}):
        load_machine(load_scene("three_axis", overrides=overrides))
    assert len(list(cache.glob("*.so"))) == 1, "libraries for three steps and starts"
    load_machine(load_scene("three_axis", overrides={"joints.elbow.gear.stiffness": 2e4}))
    assert len(list(cache.glob("*.so"))) == 2, "libraries for two gears"


@pytest.mark.parametrize(
    ("scheme", "threads", "joints"),
    with_slow(some(
        [
            ("rosenbrock", 1, 4), ("implicit", 2, 14), ("extrapolated", 2, 4), ("paper", 1, 4),
            ("extrapolated", 1, 14), ("paper", 1, 14), ("implicit", 2, 4), ("rosenbrock", 1, 14),
            ("extrapolated", 2, 14), ("extrapolated", 1, 4),
        ], 2,
    ), 1),
)  # fmt: skip
def test_the_core_compiles_without_a_warning(
    scheme: str, threads: int, joints: int, tmp_path: Path
) -> None:
    integrator = {"scheme": scheme, "dt": 1e-4}
    scene = random_chain(tmp_path, 3, joints, integrator=integrator, threads=threads)
    source = tmp_path / "unit.cpp"
    source.write_text(write_scene_unit(scene))
    flags = [flag for flag in FLAGS if flag not in ("-O3", *SHARED)]  # -O1 for the time it takes
    warnings = ["-O1", "-c", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{CORE}"]
    # The version since which GCC passes vectors in this way does not matter if the whole core is
    # compiled at once.
    warnings.append("-Wno-psabi")
    command = [*find_compiler(), *flags, *warnings, str(source), "-o", str(tmp_path / "unit.o")]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (built.returncode, built.stderr) == (0, ""), "exit code and words of the compiler"


def test_without_a_compiler_the_remedy_is_printed(
    cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    no_compiler(monkeypatch, tmp_path)
    with pytest.raises(Refusal, match=r"C\+\+ compiler must be on the path.*arm_emulator compile"):
        load_machine(load_scene("three_axis"))


@pytest.mark.slow
def test_a_library_compiled_ahead_serves_a_machine_without_a_compiler(
    cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    scene = random_chain(tmp_path, 1, 1)
    compile_ahead(scene, "x86-64", cache)
    no_compiler(monkeypatch, tmp_path)
    load_machine(scene)
    with pytest.raises(Refusal, match="target must be known, got z80; valid: native, x86-64-v4"):
        compile_ahead(scene, "z80", cache)


# Misbehaviour of compilers, and the end of the one line that reports it.
MISCHIEF = {
    "CXX=false": "compile the scene's core, got exit code 1",
    "CXX=cat": "compile the scene's core, got exit code 1",  # waits for input if it is given any
    "CXX=true": "make a library, though it reports no error, got no file",
    "CXX='unclosed": "be the words of a command, got 'unclosed (No closing quotation)",
    "CXX='' -O2": "be on the path, a scene is compiled when first used",
    "CXX=/nowhere/c++ -O2": "be on the path, a scene is compiled when first used",
    "CXX=/tmp": "be on the path, a scene is compiled when first used",
    "> $out": "got it is empty",
    "mkdir $out": "got it is no file",
    "ln -s /bin/sh $out": "got it is a link or a socket",
    "mkfifo $out": "got it is no file",
    "echo junk > $out": "got it is not a 64-bit ELF file",
    "cp /bin/sh $out": "got it lacks arm_",
    "truncate -s 1G $out": "got it holds 1073741824 bytes",
    "printf '\\377\\376 error: \\200' >&2; exit 3": "got exit code 3: \ufffd\ufffd error: \ufffd",
    "echo first; echo scene.cpp: error: why >&2; exit 1": "got exit code 1: scene.cpp: error: why",
    "printf '\\n\\n'; exit 1": "got exit code 1",
    "kill -9 $$": "got ended by SIGKILL",
    "kill -64 $$": "got ended by",
    "sleep 60 & sleep 60": "got no end within 0.5 s",
    "while :; do echo words; done": "got no end within 0.5 s",
    "exec > /dev/null 2>&1; sleep 60": "got no end within 0.5 s",
    "rm -r $(dirname $out)": "got no file",
}  # fmt: skip


@pytest.mark.parametrize("does", MISCHIEF)
def test_failures_of_a_compiler_end_in_a_line(
    does: str,
    cache: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    named = does.removeprefix("CXX=")
    monkeypatch.setenv("CXX", named if named != does else fake_compiler(tmp_path, does))
    monkeypatch.setattr(cxx, "LONGEST_RUN", 0.5 if "no end" in MISCHIEF[does] else 60.0)
    with pytest.raises(Refusal) as refusal:
        load_machine(load_scene("three_axis"))
    assert MISCHIEF[does] in str(refusal.value), refusal.value
    assert len(str(refusal.value).splitlines()) == 1, f"one line, got {refusal.value}"
    printed = capsys.readouterr().err
    assert [line[-6:] for line in printed.splitlines()] in ([], ["failed"]), printed
    assert not cache.exists() or list(cache.iterdir()) == [], "nothing half made stays"


@pytest.mark.slow
def test_random_output_of_a_compiler_is_never_loaded(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Junk, junk that begins as a library does, libraries cut short, other machines' libraries."""
    scene = load_scene("three_axis")
    full = Path(ctypes.util.find_library("c") or "libc.so.6")
    full = next(Path(line.split()[-1]) for line in Path("/proc/self/maps").read_text().splitlines()
                 if full.name in line)  # fmt: skip
    library = full.read_bytes()
    monkeypatch.setattr(compile_unit, "Library", lambda *_: pytest.fail("it was loaded"))
    compiled = tmp_path / "made"
    monkeypatch.setenv("CXX", fake_compiler(tmp_path, f'cp {compiled} "$out"'))
    rng = np.random.default_rng(4)
    for case in range(60):
        length = int(rng.integers(0, 3000))
        body = [
            rng.bytes(length),
            library[: int(rng.integers(0, 64))] + rng.bytes(length),
            library[: int(rng.integers(64, len(library)))],
            library[:18] + rng.bytes(2) + library[20:],
        ][case % 4]
        compiled.write_bytes(body)
        with pytest.raises(Refusal, match="make a library, though it reports no error"):
            load_machine(scene)
        assert list(cache.iterdir()) == [], case


def test_a_compiler_that_leaves_somebody_behind_is_not_waited_for(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CXX", fake_compiler(tmp_path, "sleep 20 & echo $! > pid; exit 1"))
    monkeypatch.chdir(tmp_path)
    started = time.monotonic()
    with pytest.raises(Refusal, match="exit code 1"):
        load_machine(load_scene("three_axis"))
    assert time.monotonic() - started < 15.0, "it waited for a process that takes 20 s"
    os.kill(int((tmp_path / "pid").read_text()), signal.SIGKILL)


@pytest.mark.slow
def test_a_full_disk_is_reported(cache: Path, tmp_path: Path) -> None:
    """No file may grow beyond some bytes, as where a disk or a quota is full."""
    for largest in (100, 10_000):
        code = f"""
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, ({largest}, {largest}))
sys.argv[1:] = ["compile", "three_axis"]
from arm_emulator.cli.command_line import main
main()
"""
        done = subprocess.run(
            [sys.executable, "-B", "-c", code],
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert done.returncode == 2, done.stderr
        lines = done.stderr.splitlines()
        assert len(lines) == 2 and lines[0].endswith("failed"), done.stderr
        assert "three_axis.yaml: " in lines[1], done.stderr
        assert compiled_in(cache) == [], "nothing half made stays"


@pytest.mark.slow
def test_processes_at_the_same_time_share_a_compilation(quick_compiler: None, cache: Path) -> None:
    command = [sys.executable, "-c", READY]
    processes = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    printed = [process.communicate(timeout=600) for process in processes]
    assert [out for out, _ in printed] == ["0.0\n"] * 3, f"time of three new machines: {printed}"
    for unit_name in ("scene three_axis", "servo periods"):
        once = sum(err.count(f"compiling {unit_name}") for _, err in printed)
        assert once == 1, f"one of them compiles {unit_name}: {printed}"
    assert len(list(cache.glob("*.so"))) == 2, "libraries of one scene, and of its periods"


def test_a_read_only_cache_falls_back(
    quick_compiler: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The user's cache cannot be made: libraries go to a folder of ours in /tmp."""
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    blocked = tmp_path / "a_file"
    blocked.touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    done = subprocess.run(
        [sys.executable, "-c", READY], capture_output=True, text=True, timeout=600, check=True
    )
    assert done.stdout == "0.0\n", "time of a new machine"
    folder = tmp_path / f"arm_emulator-{os.getuid()}"
    assert len(list(folder.glob("*.so"))) == 2, f"libraries in {folder}"


def test_compilations_of_tests_share_a_compiled_header(tmp_path: Path) -> None:
    """Each of them has a temporary folder of its own."""
    log = tmp_path / "log"
    Path(fake_compiler(tmp_path, f'echo "$*" >> {log}; touch "$out"')).rename(tmp_path / "c++")
    environment = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    words = ["-O3", "-march=native", f"-I{CORE}", f"-D{tmp_path}", "-o"]
    for name in "first", "second":
        (tmp_path / name).mkdir()
        subprocess.run(
            [Path(__file__).parents[1] / "quick_cxx", *words, tmp_path / f"{name}.so"],
            env=environment | {"TMPDIR": str(tmp_path / name)},
            check=True,
        )
    header, *units = log.read_text().splitlines()
    assert " -x c++-header " in header
    (included,) = {words.partition(" -include ")[2] for words in units}
    for file in (included, f"{included}.gch"):
        Path(file).unlink()


def test_no_place_for_a_cache_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "a_file"
    blocked.touch()
    monkeypatch.setenv(CACHE_VARIABLE, str(blocked))
    with pytest.raises(Refusal, match=f"cache folder must be writable.*set {CACHE_VARIABLE}"):
        load_machine(load_scene("three_axis"))


def running(group: int) -> list[str]:
    """Return what runs in a process group; what has ended and waits to be fetched does not."""
    result = []
    for process in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            text = process.read_text()
            state, _, its_group = text[text.rindex(")") + 2 :].split()[:3]
            if int(its_group) == group and state != "Z":
                result.append(text)
    return result


@pytest.mark.parametrize("number", with_slow([signal.SIGINT, signal.SIGTERM, signal.SIGHUP], 1))
def test_a_compiler_ends_with_the_command_that_started_it(
    number: signal.Signals, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pid = tmp_path / "pid"
    passing = tmp_path / "passing"
    passing.mkdir()
    monkeypatch.setenv("TMPDIR", str(passing))
    words = f'touch "$TMPDIR/cc.s"; echo $$ > {pid}.new; mv {pid}.new {pid}; sleep 100'
    monkeypatch.setenv("CXX", fake_compiler(tmp_path, words))
    command = [sys.executable, "-m", "arm_emulator", "compile", "three_axis"]
    if signal.getsignal(number) is signal.SIG_IGN:  # by `nohup`, in all children as well
        signal.signal(number, signal.SIG_DFL)
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        until = time.monotonic() + 60.0
        while not pid.exists() and time.monotonic() < until:
            time.sleep(0.01)
        process.send_signal(number)
        printed = process.communicate(timeout=60)[1]
    assert (process.returncode, printed.count("\n")) == (128 + number, 1), printed
    assert running(int(pid.read_text())) == [], "of the compiler's group"
    assert compiled_in(cache) == [], "nothing half made stays"
    assert list(passing.iterdir()) == []
