"""Contents of a cache, their owners, and its size."""

import contextlib
import os
import stat
import struct
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from fake_compiler import fake_compiler
from machines import make_link_urdf, write_scene

from arm_emulator import Refusal, Scene, load_scene
from arm_emulator.machine.plant.compiler import (
    build_machine_unit,
    compile_ahead,
    load_equations,
    load_machine,
    load_real_time,
)
from arm_emulator.toolchain import compile_unit, library_cache
from arm_emulator.toolchain.elf import replace_data
from arm_emulator.toolchain.library_cache import CACHE_VARIABLE, SIZE_VARIABLE

SOMEBODY = 65534  # a user who is neither we nor root
ROOT = os.geteuid() == 0
as_root = pytest.mark.skipif(not ROOT, reason="only root can act as another user")


@dataclass(frozen=True)
class Sound:
    """A scene with one joint, its library, and a compiler that gives it at once."""

    file: Path
    scene: Scene
    name: str
    body: bytes
    compiler: str

    @property
    def stored(self) -> bytes:
        return self.body + library_cache._compute_seal(self.name, self.body)

    def put(self, folder: Path) -> Path:
        folder.mkdir(exist_ok=True)
        file = folder / self.name
        file.write_bytes(self.stored)
        return file


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Sound:
    folder = tmp_path_factory.mktemp("one_link")
    at = write_scene(folder, make_link_urdf(), {"joint": {}}, name="one_link")
    scene = load_scene(at)
    for name, library in (
        ("one_link", load_machine(scene)),
        ("one_link-equations", load_equations(scene)),
        ("real_time", load_real_time()),
    ):
        body = Path(library.file).read_bytes()[: -library_cache.SEAL_SIZE]
        (folder / name).write_bytes(body)
    which = (
        'case "$(tail -n 1 "${out%.so}.cpp")" in *real_time*) name=real_time ;;'
        " *equations*) name=one_link-equations ;; *) name=one_link ;; esac"
    )
    compiler = fake_compiler(folder, f'{which}\ncp {folder}/$name "$out"')
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CXX", compiler)
        name = compile_unit._name_library(build_machine_unit(scene), "native", compile_unit.HOST)
    return Sound(at, scene, name, (folder / "one_link").read_bytes(), compiler)


@pytest.fixture
def cache(sound: Sound, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    library_cache.report_once.cache_clear()
    folder = tmp_path / "cache"
    monkeypatch.setenv(CACHE_VARIABLE, str(folder))
    monkeypatch.setenv("CXX", sound.compiler)
    return folder


# Content of the cache


KINDS = [
    *("cut", "flipped", "text", "empty", "another ELF", "under a wrong name", "no seal", "longer"),
    *("link", "loop", "nowhere", "pipe", "socket", "folder", "writable"),
]


def change(rng: np.random.Generator, file: Path, sound: Sound) -> str:
    """Spoil a cached library in a random way; returns which."""
    full = sound.stored
    damage = str(rng.choice(KINDS + ["somebody's"] * ROOT))
    file.unlink()
    if damage == "cut":
        file.write_bytes(full[: rng.integers(1, len(full))])
    elif damage == "flipped":
        bits = np.frombuffer(full, dtype=np.uint8).copy()
        for at in rng.integers(0, len(full), rng.integers(1, 4)):
            bits[at] ^= 1 << rng.integers(0, 8)
        if bits.tobytes() == full:  # the same bit twice
            bits[0] ^= 1
        file.write_bytes(bits.tobytes())
    elif damage == "text":
        file.write_bytes(rng.integers(32, 127, rng.integers(1, 10_000), dtype=np.uint8).tobytes())
    elif damage == "empty":
        file.touch()
    elif damage == "another ELF":
        file.write_bytes(Path(sys.executable).read_bytes()[:1_000_000])
    elif damage == "under a wrong name":
        file.write_bytes(sound.body + library_cache._compute_seal("another.so", sound.body))
    elif damage == "no seal":
        file.write_bytes(sound.body)
    elif damage == "longer":
        file.write_bytes(full + bytes(rng.integers(1, 5000)))
    elif damage == "link":
        file.symlink_to(sound.put(file.parent / "elsewhere"))
    elif damage == "loop":
        file.symlink_to(file)
    elif damage == "nowhere":
        file.symlink_to(file.parent / "nothing")
    elif damage == "pipe":
        os.mkfifo(file)
    elif damage == "socket":
        os.mknod(file, stat.S_IFSOCK | 0o644)
    elif damage == "folder":
        file.mkdir()
    else:
        file.write_bytes(full)
        if damage == "writable":
            file.chmod(0o644 | int(rng.choice([0o002, 0o020, 0o022])))
        else:
            os.chown(file, SOMEBODY, 0)
    return damage


@pytest.mark.slow
def test_a_spoiled_library_is_never_loaded_but_compiled_again(
    cache: Path, sound: Sound, capsys: pytest.CaptureFixture[str]
) -> None:
    """Loading one that is cut short ends the process by SIGBUS."""
    rng = np.random.default_rng(1)
    observed = set()
    for case in range(150):
        os.environ[CACHE_VARIABLE] = str(cache / str(case))
        cache.mkdir(exist_ok=True)
        file = sound.put(cache / str(case))
        damage = change(rng, file, sound)
        observed.add(damage)
        assert load_machine(sound.scene).arm_exchange, damage
        printed = capsys.readouterr().err.splitlines()
        assert len(printed) == 2, (damage, printed)
        assert printed[0].startswith(f"arm_emulator: cached library {file} is not used: "), damage
        assert printed[1].startswith("compiling scene one_link (1 joints) with "), damage
        assert stat.S_ISREG(file.lstat().st_mode), damage
        assert file.read_bytes() == sound.stored, damage
        assert file.stat().st_uid == os.geteuid() and not file.stat().st_mode & 0o022, damage
        left = {item.name for item in file.parent.iterdir()} - {"elsewhere"}
        assert left == {file.name}, (damage, left)
    assert len(observed) >= 15, observed


def test_a_folder_in_the_place_of_a_library_is_reported(cache: Path, sound: Sound) -> None:
    cache.mkdir()
    (cache / sound.name / "precious").mkdir(parents=True)
    with pytest.raises(Refusal, match="take the compiled library, got Directory not empty"):
        load_machine(sound.scene)
    assert (cache / sound.name / "precious").is_dir(), "what is not ours stays"


def test_a_foreign_file_in_the_place_of_a_lock_does_no_harm(cache: Path, sound: Sound) -> None:
    """Once, a link in its place led to a file that was emptied."""
    precious = cache.parent / "precious"
    precious.write_text("precious")
    for kind in ("link", "nowhere", "pipe", "folder", *["somebody's"] * ROOT):
        cache.mkdir(exist_ok=True)
        lock = (cache / sound.name).with_suffix(".lock")
        if kind in ("link", "nowhere"):
            lock.symlink_to(precious if kind == "link" else cache / "nothing")
        elif kind == "pipe":
            os.mkfifo(lock)
        elif kind == "folder":
            lock.mkdir()
        else:
            lock.touch(0o644)
            os.chown(lock, SOMEBODY, 0)
        (cache / sound.name).unlink(missing_ok=True)
        assert load_machine(sound.scene).arm_exchange, kind
        assert precious.read_text() == "precious", kind
        assert [item.name for item in cache.iterdir()] == [sound.name], kind


def without_periods(file: Path) -> bytes:
    """Return a copy of a library without the periods of its scene, as it lies in the cache."""
    body = file.read_bytes()[: -library_cache.SEAL_SIZE]
    return replace_data(body, "arm_scene_periods", struct.pack("<ddq", -1.0, -1.0, -1))


def test_a_library_compiled_into_a_folder_is_loaded_from_there(
    cache: Path,
    sound: Sound,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = os.umask(0o002)
    try:
        file = compile_ahead(sound.scene, "native", tmp_path / "a" / "b")[0]
    finally:
        os.umask(before)
    assert file == tmp_path / "a" / "b" / sound.name, "where it is"
    assert without_periods(file) == sound.stored[: -library_cache.SEAL_SIZE], "the library"
    monkeypatch.setenv(CACHE_VARIABLE, str(file.parent))
    with pytest.MonkeyPatch.context() as without:
        without.delenv("CXX")
        without.setenv("PATH", str(tmp_path / "a"))
        assert load_machine(sound.scene).arm_exchange, "without a compiler"
    printed = capsys.readouterr().err
    assert len(printed.splitlines()) == 3, f"a line for each compilation, got {printed}"

    monkeypatch.setenv(CACHE_VARIABLE, str(cache))
    open_to_all = tmp_path / "open"
    open_to_all.mkdir()
    open_to_all.chmod(0o777)
    file = compile_ahead(sound.scene, "native", open_to_all / "c")[0]
    assert without_periods(file) == sound.stored[: -library_cache.SEAL_SIZE], "the library"
    printed = capsys.readouterr().err
    assert (
        f"no library is loaded from {file.parent} as it is: {open_to_all} can be wr" in printed
    ), printed
    for nowhere in (file, file / "below"):
        with pytest.raises(Refusal, match=r"compile: the folder .* be writable, got (File|Not a)"):
            compile_ahead(sound.scene, "native", nowhere)


# Size


def test_the_longest_unused_libraries_are_removed(
    cache: Path, sound: Sound, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Random caches: the oldest go until the sum is allowed; nothing else is touched."""
    rng = np.random.default_rng(3)
    for case in range(30):
        folder = cache / str(case)
        folder.mkdir(parents=True)
        sizes = {}
        for age in rng.permutation(int(rng.integers(1, 12))):  # 0: used last
            second = folder / f"scene_{age}-{rng.bytes(10).hex()}.so"
            second.write_bytes(bytes(rng.integers(0, 200_000)))
            os.utime(second, (0.0, time.time() - 10.0 - age))
            sizes[int(age), second] = second.stat().st_size
        busy = {file for _, file in sizes if rng.random() < 0.2}
        names = ("notes.txt", "my-library.so", "other.lock", f"{sound.name}.so", "a.building-x")
        strangers = [folder / name for name in names]
        for stranger in strangers:
            stranger.write_bytes(bytes(300_000))
        stale = folder / f"gone-{rng.bytes(10).hex()}.building-abc"
        stale.mkdir()
        allowed = int(rng.integers(0, 1_000_000))
        monkeypatch.setenv(SIZE_VARIABLE, str(allowed / 1e6))
        monkeypatch.setenv(CACHE_VARIABLE, str(folder))
        with contextlib.ExitStack() as holding:
            for file in busy:
                holding.enter_context(library_cache.lock_library(file))
            load_machine(sound.scene)
        size = len(sound.stored) + sum(sizes.values())
        stay = {file for _, file in sizes}
        for (_, file), its in sorted(sizes.items(), reverse=True):
            if size > allowed and file not in busy:
                stay.remove(file)
                size -= its
        saved = {*stay, *strangers, folder / sound.name}
        assert set(folder.iterdir()) == saved, (case, allowed, sizes, busy)


def test_libraries_in_use_are_not_removed(cache: Path, sound: Sound) -> None:
    file = sound.put(cache)
    os.utime(file, (0.0, 0.0))
    load_machine(sound.scene)
    (entry,) = library_cache.list_entries(cache)
    result = (entry.file, entry.scene, entry.size)
    assert result == (file, "one_link", len(sound.stored)), "file, scene, size"
    assert abs(entry.used - time.time()) < 60.0, "when it was used, and now [s]"


@pytest.mark.parametrize("size", ["-1", "nan", "much", "1e-3x"])
def test_a_malformed_size_is_refused(
    size: str, cache: Path, sound: Sound, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(SIZE_VARIABLE, size)
    with pytest.raises(Refusal, match=f"{SIZE_VARIABLE} must be a number >= 0 .MB., got {size}"):
        load_machine(sound.scene)


def arm_emulator(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "arm_emulator", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_the_command_lists_and_clears(cache: Path, sound: Sound) -> None:
    file = sound.put(cache)
    (cache / "notes.txt").touch()
    text = arm_emulator("cache")
    assert text.returncode == 0, text.stderr
    lines = text.stdout.splitlines()
    assert lines[0] == f"{cache}: trusted", lines
    size = f"{len(sound.stored) / 1e6:.3f}"
    assert lines[1].split()[2:] == [size, "MB", "one_link", file.name], lines
    assert lines[2] == f"  1 libraries, {size} of 500 MB ({SIZE_VARIABLE})", lines
    with library_cache.lock_library(file):
        busy = arm_emulator("cache", "--clear")
        assert busy.returncode == 1 and f"{file.name} stays" in busy.stdout, busy.stdout
    cleared = arm_emulator("cache", "--clear").stdout
    assert cleared == f"{cache}: 1 libraries removed\n", "what it states"
    assert [item.name for item in cache.iterdir()] == ["notes.txt"], "what stays"
    cache.chmod(0o777)
    printed = arm_emulator("cache").stdout
    assert f"{cache}: not trusted" in printed, printed
