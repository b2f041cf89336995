"""A unit: C or C++ source of one library, and the digests that name what is compiled of it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from arm_emulator.toolchain import library_cache
from arm_emulator.toolchain.c_header import Header
from arm_emulator.toolchain.targets import describe_processor
from arm_emulator.workarounds import gcc_constant_copies


@dataclass(frozen=True)
class Unit:
    """C or C++ source of one library.

    Attributes:
        name: name of its file.
        source: the text.
        flags: of the compiler.
        folders: folders of included files.
        headers: headers of its functions.
        where: name in refusals.
        about: message during compilation.
        part: name of the compiled part in refusals.
        beside: a further source, compiled separately in the same command. The code of `source`, and
            the bits of its results, do therefore not depend on it.
        data: bytes of exported objects in copies outside the cache, by their names; units that
            differ in it alone share a library in the cache.
        more: further exported functions, declared in no header.
        saves_as: the unit whose saved machines this one restores; None: only its own.
    """

    name: str
    source: str
    flags: tuple[str, ...]
    folders: tuple[Path, ...]
    headers: tuple[Header, ...]
    where: str
    about: str
    part: str
    beside: str = ""
    data: Mapping[str, bytes] = field(default_factory=dict)
    more: tuple[str, ...] = ()
    saves_as: Unit | None = None

    @property
    def functions(self) -> tuple[str, ...]:
        """Names of all exported functions."""
        return (*(name for header in self.headers for name in header.functions), *self.more)


def compute_fingerprint(unit: Unit) -> str:
    """Return a digest of what decides how a saved unit goes on, as a number of C.

    It is of sources and flags, but not of compiler, level of optimisation and target: all of these
    give the same bits.
    """
    saved = unit.saves_as or unit
    flags = [flag for flag in saved.flags if not flag.startswith("-O")]
    return f"0x{_digest_parts(saved, flags)[:16]}u"


def compute_sources_digest(unit: Unit) -> str:
    """Return a digest of a unit's sources, without flags and compiler."""
    digest = hashlib.sha256(unit.source.encode())
    for folder in unit.folders:
        digest.update(_digest_folder(folder))
    return digest.hexdigest()[:12]


def list_definitions(unit: Unit) -> list[str]:
    """Return the words of a command that name a unit's folders, and define its fingerprint."""
    folders = [f"-I{folder}" for folder in unit.folders]
    return [*folders, f"-DARM_FINGERPRINT={compute_fingerprint(unit)}"]


def name_stem(name: str) -> str:
    """Return the begin of the file names of a unit's libraries, up to its digest.

    It is a name for every file system, even with a suffix for files beside the library.
    """
    return "".join(c if (c.isascii() and c.isalnum()) or c == "-" else "_" for c in name)[:60]


def compute_digest(unit: Unit, target: str) -> str:
    """Return a digest of all that decides what is compiled of a unit, but its compiler."""
    processor = describe_processor() if target == "native" else ""
    # Libraries from before that flag may have wrong constants.
    flags = " ".join((*unit.flags, gcc_constant_copies.FLAG))
    return _digest_parts(unit, (flags, target, processor))


def _digest_parts(unit: Unit, more: Iterable[str]) -> str:
    digest = hashlib.sha256(library_cache.SEAL)
    for folder in unit.folders:
        digest.update(_digest_folder(folder))
    sources = (unit.source, unit.beside) if unit.beside else (unit.source,)
    for part in (*sources, *more):
        digest.update(part.encode())
        digest.update(b"\0")
    return digest.hexdigest()


_SOURCES = (".c", ".h", ".cpp", ".hpp")


@cache
def _digest_folder(folder: Path) -> bytes:
    digest = hashlib.sha256()
    for file in sorted(file for file in folder.rglob("*") if file.suffix in _SOURCES):
        digest.update(file.relative_to(folder).as_posix().encode())
        digest.update(file.read_bytes())
    return digest.digest()
