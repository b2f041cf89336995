"""Compilation of units into shared libraries and other files, cached by content."""

from __future__ import annotations

import contextlib
import hashlib
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TypeVar

from arm_emulator.base.refusal import Refusal
from arm_emulator.toolchain import library_cache
from arm_emulator.toolchain.c_header import Library
from arm_emulator.toolchain.compiler_command import (
    find_compiler,
    identify_compiler,
    is_compiler_alone,
    is_compiler_named,
)
from arm_emulator.toolchain.elf import explain_no_library
from arm_emulator.toolchain.targets import PORTABLE_TARGETS, is_supported_here
from arm_emulator.toolchain.trusted import Untrusted, check_folder, read_file
from arm_emulator.toolchain.unit import Unit, compute_digest, list_definitions, name_stem
from arm_emulator.workarounds import gcc_constant_copies

OF_COMPILER = 6  # of the 20 digits in the name of a library, those of its compiler


@dataclass(frozen=True)
class UnitCompiler:
    """A program that makes a file of a unit.

    Attributes:
        suffix: of the file.
        find: returns the words of its command, or raises a `Refusal`.
        is_named: returns whether the user has named it; if so, no cached file of another compiler
            is taken.
        build: makes the file of a unit for a target in a folder, and returns its content.
    """

    suffix: str
    find: Callable[[], list[str]]
    is_named: Callable[[], bool]
    build: Callable[[list[str], Unit, str, Path], bytes]


def load_library(unit: Unit) -> Library:
    """Return a unit as a library, compiling it if no cached one fits.

    Raises:
        Refusal: there is neither a sound cached library nor a working compiler.
    """
    for folder in library_cache.list_cache_folders():
        for target in ("native", *PORTABLE_TARGETS):
            if target == "native" or is_supported_here(target):
                library = _load_cached(unit, target, folder, HOST, _load_library)
                if library is not None:
                    return library
    return _load_compiled(unit, "native", HOST, _load_library)


def load_file(unit: Unit, target: str, compiler: UnitCompiler) -> bytes:
    """Return the file that a compiler makes of a unit, from the cache if one fits.

    Args:
        unit: the unit.
        target: as `compiler` knows it.
        compiler: for example one for cards.

    Raises:
        Refusal: there is neither a sound cached file nor a working compiler.
    """
    for folder in library_cache.list_cache_folders():
        content = _load_cached(unit, target, folder, compiler, _read_file)
        if content is not None:
            return content
    return _load_compiled(unit, target, compiler, _read_file)


def compile_file(unit: Unit, target: str, compiler: UnitCompiler, folder: Path | None) -> Path:
    """Return where the file that a compiler makes of a unit is, see `load_file`.

    Args:
        unit: see there.
        target: see there.
        compiler: see there.
        folder: folder for a copy; None: only the cache.

    Raises:
        Refusal: the compiler is missing or fails, or no folder is writable.
    """
    cache = next(library_cache.list_writable_caches())
    return _compile_ahead(unit, target, cache, folder, compiler)


_Loaded = TypeVar("_Loaded", bytes, Library)


def _load_cached(
    unit: Unit,
    target: str,
    folder: Path,
    compiler: UnitCompiler,
    load: Callable[[Path, Unit], _Loaded],
) -> _Loaded | None:
    for file in _list_candidates(unit, target, folder, compiler):
        try:
            return load(file, unit)
        except FileNotFoundError:
            continue
        except library_cache.DamagedLibrary as error:
            _report_damaged(file, error)
    return None


def _load_compiled(
    unit: Unit, target: str, compiler: UnitCompiler, load: Callable[[Path, Unit], _Loaded]
) -> _Loaded:
    for folder in library_cache.list_writable_caches():
        with _ensure_compiled(unit, target, folder, compiler) as file:
            try:
                return load(file, unit)
            except (library_cache.DamagedLibrary, FileNotFoundError) as error:
                _report_damaged(file, error)
    raise AssertionError("list_writable_caches ends with a refusal")


def compile_once(unit: Callable[[], Unit]) -> Callable[[], Library]:
    """Return a function that calls `load_library` with a unit once, and then returns the same
    again.

    Args:
        unit: makes the unit, at the first call.
    """
    return cache(lambda: load_library(unit()))


def _read_file(file: Path, _: Unit) -> bytes:
    return library_cache.read_library(file)


def _load_library(file: Path, unit: Unit) -> Library:
    library_cache.read_library(file)
    try:
        return Library(file, unit.headers)
    except OSError as error:  # for example a file system that is mounted with noexec
        raise library_cache.DamagedLibrary(f"the loader reports {error}") from None


def compile_units(units: Iterable[Unit], target: str, folder: Path | None) -> list[Path]:
    """Compile units for `target`, for machines without a compiler.

    Args:
        units: the units.
        target: "native" or one of `PORTABLE_TARGETS`.
        folder: folder for copies of the libraries; None: only the cache.

    Returns:
        Paths of the libraries.

    Raises:
        Refusal: the target is unknown, the compiler is missing or fails, or no folder is writable.
    """
    targets = ("native", *PORTABLE_TARGETS)
    if target not in targets:
        raise Refusal("compile", "target", "be known", target, ", ".join(targets))
    cache = next(library_cache.list_writable_caches())
    return [_compile_ahead(unit, target, cache, folder, HOST) for unit in units]


def compile_bytes(unit: Unit, target: str) -> bytes:
    """Return a unit's library as it is loaded outside of our cache.

    Args:
        unit: the unit.
        target: see `compile_units`.

    Raises:
        Refusal: see there.
    """
    (file,) = compile_units([unit], target, None)
    return file.read_bytes()[: -library_cache.SEAL_SIZE]


def _compile_ahead(
    unit: Unit, target: str, cache: Path, folder: Path | None, compiler: UnitCompiler
) -> Path:
    with _ensure_compiled(unit, target, cache, compiler) as library:
        if folder is None:
            return library
        try:
            try:
                folder = check_folder(folder, make=0o755)
            except Untrusted as reason:  # it may be on its way to another place
                library_cache.report_once(
                    f"arm_emulator: no library is loaded from {folder} as it is: {reason}"
                )
                folder.mkdir(parents=True, exist_ok=True)
            if folder.resolve() == library.parent.resolve():
                return library
            return library_cache.copy_into(library, folder, unit.data)
        except OSError as error:
            raise Refusal(
                "compile", f"the folder {folder}", "be writable", error.strerror
            ) from None


@contextlib.contextmanager
def _ensure_compiled(
    unit: Unit, target: str, folder: Path, compiler: UnitCompiler
) -> Iterator[Path]:
    """Yield the path of a unit's library or file in a folder of ours, compiled if missing.

    Several processes may do this at once: one compiles, the others wait for it. While the lock is
    held, the library is not removed.

    Raises:
        Refusal: the compiler is missing or fails, or the folder cannot store its output.
    """
    library = folder / _name_library(unit, target, compiler)
    with contextlib.ExitStack() as locks:
        try:
            locks.enter_context(library_cache.lock_library(library))
            try:
                library_cache.read_library(library)
            except (library_cache.DamagedLibrary, FileNotFoundError):
                _compile_unit(unit, target, library, compiler)
        except OSError as error:
            raise Refusal(unit.where, f"cache folder {folder}", "take the compiled library",
                          f"{error.strerror} ({error.filename})") from None  # fmt: skip
        yield library


def _compile_unit(unit: Unit, target: str, library: Path, compiler: UnitCompiler) -> None:
    command = compiler.find()
    largest = library_cache.read_largest_size()
    print(
        f"compiling {unit.about} with {identify_compiler(command)} ... ",
        end="",
        file=sys.stderr,
        flush=True,
    )
    started = time.perf_counter()
    end = "failed"
    try:
        with library_cache.make_scratch(library) as scratch:
            content = compiler.build(command, unit, target, scratch)
            library_cache.store_file(library, content, scratch)
            library_cache.make_room(library, largest)
        end = f"{time.perf_counter() - started:.1f} s"
    finally:
        print(end, file=sys.stderr)


def _build_library(command: list[str], unit: Unit, target: str, scratch: Path) -> bytes:
    # Most processes find their library compiled, and need no module that starts processes.
    from arm_emulator.toolchain.cxx import run_compiler

    source, built = scratch / "unit.cpp", scratch / "unit.so"
    source.write_text(unit.source, encoding="utf-8")
    march = f"-march={target}"
    macros = ""
    with contextlib.suppress(Refusal):  # the compilation states a compiler's defects
        words = [*command, march, "-dM", "-E", "-x", "c", "-"]
        macros = run_compiler(words, scratch, unit.where, unit.part)
    words = [*command, *unit.flags, march, *gcc_constant_copies.list_flags(macros)]
    words += list_definitions(unit)
    if unit.beside:
        beside = scratch / "beside.cpp"
        beside.write_text(unit.beside, encoding="utf-8")
        words.append(str(beside))
    run_compiler([*words, str(source), "-o", str(built)], scratch, unit.where, unit.part)
    return _read_built(built, command[0], unit)


HOST = UnitCompiler("so", find_compiler, is_compiler_named, _build_library)


def _read_built(file: Path, compiler: str, unit: Unit) -> bytes:
    """Return the library that the compiler reports to have made."""
    body = b""
    try:
        # The folder is closed to others, for any umask.
        body = read_file(file, library_cache.LARGEST_LIBRARY, anybodys=True)
        reason = explain_no_library(body, (*unit.functions, *unit.data))
    except FileNotFoundError:
        reason = "no file"
    except (OSError, Untrusted) as error:
        reason = str(error)
    if reason:
        raise Refusal(unit.where, f"compiler {compiler}",
                      "make a library, though it reports no error", reason)  # fmt: skip
    return body


def _list_candidates(
    unit: Unit, target: str, folder: Path, compiler: UnitCompiler
) -> Iterator[Path]:
    """Yield possible paths of a unit's library in a folder, the preferred one first.

    First that of the compiler in use; then, unless the user has named it, those of other compilers,
    made here or elsewhere. Of a compiler with options, or a program that calls one, a library may
    be slow or have checks: it serves who names that, or has no compiler.
    """
    own = None
    with contextlib.suppress(Refusal):  # no compiler, or no command in $CXX
        own = folder / _name_library(unit, target, compiler)
        yield own
        if compiler.is_named():
            return
    for first in ("[0-7]",) if own else ("[0-7]", "[89a-f]"):
        digits = first + "[0-9a-f]" * (OF_COMPILER - 1)
        others = sorted(folder.glob(f"{_name_stem(unit, target)}{digits}.{compiler.suffix}"))
        yield from (file for file in others if file != own)


def _report_damaged(file: Path, error: Exception) -> None:
    library_cache.report_once(f"arm_emulator: cached library {file} is not used: {error}")


def _name_library(unit: Unit, target: str, compiler: UnitCompiler) -> str:
    command = compiler.find()
    digits = hashlib.sha256(identify_compiler(command).encode()).hexdigest()[:OF_COMPILER]
    # The first digit states whether it is a compiler alone.
    first = f"{int(digits[0], 16) % 8 + (0 if is_compiler_alone(command) else 8):x}"
    return f"{_name_stem(unit, target)}{first}{digits[1:]}.{compiler.suffix}"


def _name_stem(unit: Unit, target: str) -> str:
    return f"{name_stem(unit.name)}-{compute_digest(unit, target)[: 20 - OF_COMPILER]}"
