"""Folders of the cache that another user could change are not searched; its files are private."""

import contextlib
import os
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from test_library_cache import ROOT, SOMEBODY, Sound, as_root, cache, sound

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.compiler import load_machine
from arm_emulator.machine.plant.core_calls import ARM
from arm_emulator.tick.c import REAL_TIME
from arm_emulator.toolchain.compiler_command import find_compiler
from arm_emulator.toolchain.library_cache import CACHE_VARIABLE

__all__ = ["cache", "sound"]  # fixtures

LOAD = """
import sys
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.scene.scene import load_scene
try:
    print(Plant(load_scene(sys.argv[1])).t)
except Refusal as refusal:
    sys.exit(str(refusal))
"""


@dataclass(frozen=True)
class Planted(Sound):
    """A library that leaves a mark when it is loaded."""

    mark: Path

    def ran(self) -> bool:
        """Whether it has been loaded since this was asked last."""
        result = self.mark.exists()
        self.mark.unlink(missing_ok=True)
        return result


@pytest.fixture(scope="module")
def planted(sound: Sound, tmp_path_factory: pytest.TempPathFactory) -> Planted:
    folder = tmp_path_factory.mktemp("planted")
    mark = folder / "mark"
    source = folder / "planted.cpp"
    functions = "".join(f"void {name}() {{}}\n" for name in (*ARM.functions, *REAL_TIME.functions))
    source.write_text(
        f'#include <cstdio>\nextern "C" {{\n{functions}}}\n'
        f'__attribute__((constructor)) void run() {{ fclose(fopen("{mark}", "w")); }}\n'
    )
    built = folder / "planted.so"
    subprocess.run(
        [*find_compiler(), "-shared", "-fPIC", str(source), "-o", str(built)], check=True
    )
    return Planted(sound.file, sound.scene, sound.name, built.read_bytes(), "false", mark)


def chain(rng: np.random.Generator, top: Path) -> tuple[Path, str]:
    """Make a chain of folders with at most one thing wrong; returns the last, and what is wrong.

    "": nothing is wrong, also where it looks odd.
    """
    wrong = ["group", "others", "folder sticky", "folder a link", "dots behind a link"]
    wrong += ["somebody's", "somebody's link", "root's group"] * ROOT
    fine = ["", "", "sticky above", "link above", "dots", "dots behind a sound link"]
    setup = str(rng.choice(wrong + fine))
    parts = [f"level_{level}" for level in range(rng.integers(2, 5))]
    folder = top.joinpath(*parts)
    folder.mkdir(parents=True)
    folder.chmod(0o755)
    level = int(rng.integers(1, len(parts)))  # of an ancestor, or of the folder itself
    above = top.joinpath(*parts[:level])
    any_of_them = top.joinpath(*parts[: rng.integers(1, len(parts) + 1)])
    if setup in ("group", "others"):
        any_of_them.chmod(0o775 if setup == "group" else 0o757)
    elif setup == "root's group":
        os.chown(any_of_them, 0, SOMEBODY)
        any_of_them.chmod(0o2775)
    elif setup == "somebody's":
        os.chown(any_of_them, SOMEBODY, 0)
    elif setup == "folder sticky":
        folder.chmod(0o1777)
    elif setup == "sticky above":
        above.chmod(0o1777)
    elif setup in ("folder a link", "link above", "somebody's link"):
        which = above if setup == "link above" else folder if "folder" in setup else any_of_them
        real = which.rename(which.with_name("real"))
        which.symlink_to(real if rng.integers(2) else real.name)
        if setup == "somebody's link":
            os.lchown(which, SOMEBODY, 0)
    elif setup.startswith("dots behind"):
        # The parent of the link's target, beside a sound folder of the same name.
        elsewhere = top / "elsewhere"
        (elsewhere / "inner").mkdir(parents=True)
        (elsewhere / folder.name).mkdir()
        elsewhere.chmod(0o755 if setup in fine else 0o777)
        (folder.parent / "link").symlink_to(elsewhere / "inner")
        folder = folder.parent / "link" / ".." / folder.name
    elif setup == "dots":
        folder = above / ".." / "." / folder.relative_to(above.parent)
    return folder, "" if setup in fine else setup


@pytest.mark.slow
def test_only_a_private_folder_is_searched(
    planted: Planted,
    sound: Sound,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    rng = np.random.default_rng(2)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "mine"))
    monkeypatch.setenv("CXX", sound.compiler)
    (tmp_path / "mine").mkdir(0o700)
    sound.put(tmp_path / "mine" / "arm_emulator")
    outcomes = []
    for case in range(150):
        folder, wrong = chain(rng, tmp_path / str(case))
        planted.put(folder)
        monkeypatch.setenv(CACHE_VARIABLE, str(folder))
        core = load_machine(sound.scene)
        printed = capsys.readouterr().err.splitlines()
        assert planted.ran() == (not wrong), (folder, wrong)
        assert (Path(core.file).parent == folder.resolve()) == (not wrong), (folder, wrong)
        assert len(printed) == bool(wrong), (folder, wrong, printed)
        if wrong:
            assert printed[0].startswith(f"arm_emulator: cache folder {folder} is passed over: "), (
                printed
            )
        outcomes.append(wrong)
    assert len(set(outcomes)) >= (8 if ROOT else 5), set(outcomes)


@pytest.fixture
def shared() -> Iterator[Path]:
    """A folder for temporary files in which everybody may write, as /tmp."""
    # The last act of a killed attacker's command may come after the clean-up.
    with tempfile.TemporaryDirectory(dir="/tmp", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        folder.chmod(0o1777)
        yield folder


@pytest.fixture
def bait(planted: Planted, shared: Path) -> Path:
    """The planted library, in that folder, where everybody may read it."""
    bait = shared / "bait"
    bait.write_bytes(planted.stored)
    bait.chmod(0o644)
    return bait


def victim(shared: Path, **also: str) -> dict[str, str]:
    """The environment of somebody who has no cache but the one in the temporary folder."""
    nowhere = shared / "a_file"
    nowhere.touch()
    environment = {**os.environ, "TMPDIR": str(shared), "XDG_CACHE_HOME": str(nowhere), **also}
    environment.pop(CACHE_VARIABLE, None)
    return environment


@contextlib.contextmanager
def attacked(script: str) -> Iterator[None]:
    attacker = subprocess.Popen(
        ["sh", "-c", script], user=SOMEBODY, group=SOMEBODY, extra_groups=[], start_new_session=True
    )
    try:
        yield
    finally:
        os.killpg(attacker.pid, 9)
        attacker.wait()


def become_victim(monkeypatch: pytest.MonkeyPatch, shared: Path, sound: Sound) -> None:
    for name, value in victim(shared, CXX=sound.compiler).items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(shared))


@as_root
def test_a_library_that_another_user_plants_in_the_temporary_folder_never_runs(
    planted: Planted, sound: Sound, shared: Path, bait: Path
) -> None:
    """The attacker is another user indeed, and knows the name and how a library is stored."""
    folder = shared / f"arm_emulator-{os.getuid()}"
    plant = f"mkdir {folder} && cp {bait} {folder}/{sound.name} && chmod 700 {folder}"
    subprocess.run(["sh", "-c", plant], user=SOMEBODY, group=SOMEBODY, extra_groups=[], check=True)
    done = subprocess.run(
        [sys.executable, "-c", LOAD, str(sound.file)],
        env=victim(shared, CXX=sound.compiler),
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert not planted.ran(), "what somebody else put there has run"
    printed = done.stderr.splitlines()
    assert done.returncode == 1 and len(printed) == 2, done.stderr
    assert f"{folder} is passed over: {folder} belongs to user" in printed[0], printed
    assert "cache folder must be writable" in printed[1], printed


@pytest.mark.slow
@as_root
def test_swapping_folders_during_the_check_gains_nothing(
    planted: Planted, sound: Sound, shared: Path, bait: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Folder, link to ours, link to theirs, nothing: as fast as a shell can, in our temp folder."""
    ours = shared / "ours"
    ours.mkdir(0o755)
    sound.put(ours)
    at = shared / f"arm_emulator-{os.getuid()}"
    swap = (
        f"cd {shared}; mkdir theirs; cp {bait} theirs/{sound.name}; while :; do "
        f"ln -s ours {at}; mv theirs x; rm {at}; mv x {at}; mv {at} theirs; ln -s theirs {at};"
        f"rm {at}; done 2> /dev/null"
    )
    become_victim(monkeypatch, shared, sound)
    with attacked(swap):
        tries = 0
        until = time.monotonic() + 1.5
        while time.monotonic() < until or tries < 100:
            with contextlib.suppress(Refusal):
                load_machine(sound.scene)
            assert not planted.ran(), tries
            tries += 1
            with contextlib.suppress(FileNotFoundError):  # what we have made would end the race
                if at.lstat().st_uid == 0:
                    at.rename(shared / f"made_{tries}")
    assert not planted.ran(), tries


@as_root
def test_swapping_the_folder_before_two_dots_gains_nothing(
    planted: Planted, sound: Sound, shared: Path, bait: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`swapped/../cache` is our folder by its text, and theirs by a link."""
    (shared / "cache").mkdir(0o755)
    sound.put(shared / "cache")
    become_victim(monkeypatch, shared, sound)
    monkeypatch.setenv(CACHE_VARIABLE, str(shared / "swapped" / ".." / "cache"))
    swap = (
        f"cd {shared}; mkdir -p theirs/deep theirs/cache; cp {bait} theirs/cache/{sound.name}; "
        "while :; do ln -s theirs/deep swapped; rm swapped; mkdir swapped; rmdir swapped; done "
        "2> /dev/null"
    )
    with attacked(swap):
        until = time.monotonic() + 1.0
        while time.monotonic() < until:
            load_machine(sound.scene)  # of the temporary folder
            assert not planted.ran(), "what somebody else put there has run"
    assert not planted.ran(), "what somebody else put there has run"


@pytest.mark.parametrize("umask", [0o000, 0o002, 0o022, 0o027, 0o077])
def test_files_of_the_cache_are_private_under_any_umask(
    umask: int, cache: Path, sound: Sound, capsys: pytest.CaptureFixture[str]
) -> None:
    os.environ[CACHE_VARIABLE] = str(cache / "a" / "b")
    before = os.umask(umask)
    try:
        load_machine(sound.scene)
        capsys.readouterr()
        load_machine(sound.scene)
    finally:
        os.umask(before)
    assert capsys.readouterr().err == "", "it is found, and trusted"
    for folder in (cache, cache / "a", cache / "a" / "b"):
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700, folder
    mode = stat.S_IMODE((cache / "a" / "b" / sound.name).stat().st_mode)
    assert mode == 0o644 & ~umask, f"mode {mode:o} of the library"
