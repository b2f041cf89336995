"""Cache of compiled scenes: lookup, storage, size limit.

A library file is the compiler's output followed by a digest of it and of the file's name: a file
that was truncated, changed or renamed is detected before any of it runs. The digest is not a
signature; owner and folder of the file ensure that no other user wrote it (`trusted`).

Most processes find what they look for in the first folder and write nothing: what only others need
(`tempfile`, `shutil`) is imported there.
"""

import contextlib
import fcntl
import hashlib
import math
import os
import re
import stat
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from arm_emulator.base.refusal import Refusal
from arm_emulator.toolchain.elf import replace_data
from arm_emulator.toolchain.trusted import Untrusted, check_folder, read_file

CACHE_VARIABLE = "ARM_EMULATOR_CACHE"
SIZE_VARIABLE = "ARM_EMULATOR_CACHE_MB"
DEFAULT_SIZE = 500.0  # MB; a library takes some 0.05 to 0.5 MB

OURS = 0o700  # mode of the folders we make
LOCK = 0o600  # mode of lock files
LARGEST_LIBRARY = 2**28  # bytes; far more than any scene's
SEAL = b"arm_emulator"
SEAL_SIZE = len(SEAL) + hashlib.sha256().digest_size

# Only files with such a name are ever removed, so that a cache may share a folder with other files.
LIBRARY = re.compile(r"(?P<scene>[\w-]+)-[0-9a-f]{20}\.(so|cdef|ptx|cubin)", re.ASCII)
LEFT_OVER = re.compile(r"(?P<library>[\w-]+-[0-9a-f]{20})\.(lock|building-\w+)", re.ASCII)


class DamagedLibrary(Exception):
    """A library is not what was stored; the text gives the difference."""


# Folders


def list_named_folders() -> Iterator[Path]:
    """Yield possible cache folders, the preferred one first; they need not exist or be ours.

    A folder that is named in the environment is the only one, unless it is not trusted.
    """
    named = os.environ.get(CACHE_VARIABLE)
    if named:
        yield Path(named)
        if not explain_distrust(Path(named)):
            return
    user = os.environ.get("XDG_CACHE_HOME", "")
    with contextlib.suppress(RuntimeError):  # no HOME, and no such user
        base = Path(user) if user.startswith("/") else Path.home() / ".cache"
        yield base / "arm_emulator"
    import tempfile

    with contextlib.suppress(OSError):  # no temporary folder
        yield Path(tempfile.gettempdir()) / f"arm_emulator-{os.getuid()}"


def list_cache_folders() -> Iterator[Path]:
    """Yield the folders that are ours; others are skipped with a line each."""
    for folder in list_named_folders():
        try:
            trusted = check_folder(folder)
        except Untrusted as error:
            _report_passed_over(folder, error)
        except OSError:  # missing, or not accessible
            continue
        else:
            yield trusted


def explain_distrust(folder: Path) -> str:
    """Return why another user may own content of a folder, or ""; also "" for a missing folder."""
    try:
        check_folder(folder)
    except Untrusted as error:
        return str(error)
    except OSError:
        return ""
    return ""


def list_writable_caches() -> Iterator[Path]:
    """Yield the folders that accept new libraries, the preferred one first; create missing ones.

    Raises:
        Refusal: none is left.
    """
    import tempfile

    reasons = []
    for folder in list_named_folders():
        try:
            checked = check_folder(folder, make=OURS)
            with tempfile.TemporaryFile(dir=checked):
                pass
        except Untrusted as error:
            _report_passed_over(folder, error)
        except OSError as error:
            reasons.append(f"{folder}: {error.strerror}")
        else:
            yield checked
            reasons.append(f"{folder}: see above")
    raise Refusal(
        "arm_emulator",
        "cache folder",
        "be writable",
        "; ".join(reasons) or "none that can be trusted",
        f"set {CACHE_VARIABLE} to a folder of yours",
    )


def _report_passed_over(folder: Path, reason: Untrusted) -> None:
    report_once(f"arm_emulator: cache folder {folder} is passed over: {reason}")


@cache
def report_once(line: str) -> None:
    """Print a line on stderr, once per process."""
    print(line, file=sys.stderr, flush=True)


# Libraries


def read_library(file: Path) -> bytes:
    """Return the stored bytes of a file after checking all of them, and mark it as used.

    Raises:
        DamagedLibrary: it differs from what was stored.
        FileNotFoundError: it is missing.
    """
    try:
        sealed = read_file(file, LARGEST_LIBRARY)
    except FileNotFoundError:
        raise
    except Untrusted as error:
        raise DamagedLibrary(str(error)) from None
    except OSError as error:
        raise DamagedLibrary(f"it cannot be read: {error.strerror}") from None
    if not sealed:
        raise DamagedLibrary("it is empty")
    body, seal = sealed[:-SEAL_SIZE], sealed[-SEAL_SIZE:]
    if seal != _compute_seal(file.name, body):
        raise DamagedLibrary("it is cut short, changed, or was never stored here")
    return body


@contextlib.contextmanager
def make_scratch(library: Path) -> Iterator[Path]:
    """Yield a new locked folder beside a library, and remove it at the end."""
    import tempfile

    _clear_left_over(library)
    with tempfile.TemporaryDirectory(
        prefix=f"{library.stem}.building-", dir=library.parent, ignore_cleanup_errors=True
    ) as scratch:
        yield Path(scratch)


def store_file(file: Path, body: bytes, scratch: Path) -> None:
    """Store a file: written beside it, in `scratch`, then renamed.

    Raises:
        OSError: it could not be written.
    """
    beside = scratch / "sealed"
    # Not wider than this for any umask: a file that its group can write is not loaded.
    opened = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o644)
    with open(opened, "wb") as handle:
        handle.write(body + _compute_seal(file.name, body))
    with contextlib.suppress(FileNotFoundError):
        if stat.S_ISDIR(os.lstat(file).st_mode):
            os.rmdir(file)  # a file cannot be renamed to a folder, even an empty one
    os.replace(beside, file)


def copy_into(library: Path, folder: Path, data: Mapping[str, bytes]) -> Path:
    """Copy a library into another folder, and return its path there.

    Args:
        library: in a cache.
        folder: the other one.
        data: bytes of the copy's objects, by their names.

    Raises:
        OSError: it could not be written.
    """
    import tempfile

    file = folder / library.name
    body = library.read_bytes()[:-SEAL_SIZE]
    for name, content in data.items():
        body = replace_data(body, name, content)
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        store_file(file, body, Path(scratch))
    return file


def _compute_seal(name: str, body: bytes) -> bytes:
    digest = hashlib.sha256(name.encode() + b"\0")
    digest.update(body)
    return SEAL + digest.digest()


@contextlib.contextmanager
def lock_library(library: Path, wait: bool = True) -> Iterator[None]:
    """Hold the lock of a library; other processes wait for it.

    The lock is a file beside the library that exists while a process holds it.

    Raises:
        BlockingIOError: another process holds it, and `wait` is False.
        OSError: no lock can be made there.
    """
    file = library.with_suffix(".lock")
    opened = _lock_file(file, wait)
    try:
        yield
    finally:
        file.unlink(missing_ok=True)
        os.close(opened)


def _lock_file(file: Path, wait: bool) -> int:
    while True:
        _clear_invalid_lock(file)
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        opened = os.open(file, flags, LOCK)
        try:
            # On a file system without locks, at worst two processes compile the same library.
            with contextlib.suppress(OSError) if wait else contextlib.nullcontext():
                fcntl.flock(opened, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            # The previous holder has removed the file; other processes would not see our lock.
            if os.path.samestat(os.fstat(opened), os.lstat(file)):
                return opened
        except FileNotFoundError:
            pass
        except BaseException:
            os.close(opened)
            raise
        os.close(opened)


def _clear_invalid_lock(file: Path) -> None:
    """Leave at `file` nothing, or a lock that no other user can hold indefinitely."""
    with contextlib.suppress(FileNotFoundError):
        status = os.lstat(file)
        if stat.S_ISDIR(status.st_mode):
            os.rmdir(file)
        elif status.st_mode != stat.S_IFREG | LOCK or status.st_uid != os.geteuid():
            os.unlink(file)


# Size


@dataclass(frozen=True)
class CacheEntry:
    """A library in a folder, or the remains of one."""

    file: Path
    scene: str
    size: int  # bytes
    used: float  # s since 1970


def list_entries(folder: Path) -> list[CacheEntry]:
    """Return the libraries in a folder, the least recently used first."""
    entries = []
    with contextlib.suppress(OSError), os.scandir(folder) as items:
        for item in items:
            name = LIBRARY.fullmatch(item.name)
            with contextlib.suppress(OSError):  # another process may just have removed it
                at = item.stat(follow_symlinks=False)
                if name and not item.is_dir(follow_symlinks=False):
                    entries.append(
                        CacheEntry(Path(folder, item.name), name["scene"], at.st_size, at.st_mtime)
                    )
    return sorted(entries, key=lambda entry: entry.used)


def read_largest_size() -> float:
    """Return the largest size of a cache folder [bytes].

    Raises:
        Refusal: $ARM_EMULATOR_CACHE_MB is not a size.
    """
    text = os.environ.get(SIZE_VARIABLE) or str(DEFAULT_SIZE)
    try:
        size = float(text)
    except ValueError:
        size = math.nan
    if not size >= 0.0:
        raise Refusal("arm_emulator", SIZE_VARIABLE, "be a number >= 0 [MB]", text)
    return size * 1e6


def make_room(library: Path, allowed: float) -> None:
    """Remove the least recently used libraries until a folder is within its size.

    Remains of interrupted compilations are removed, too.

    Args:
        library: the newest; it stays, whatever its size.
        allowed: largest size of its folder [bytes].
    """
    folder = library.parent
    entries = list_entries(folder)
    size = sum(entry.size for entry in entries)
    for entry in entries:
        if size <= allowed:
            break
        if entry.file != library and remove_library(entry.file):
            size -= entry.size
    for left_over in list_left_over(folder):
        with contextlib.suppress(OSError), lock_library(left_over, wait=False):
            _clear_left_over(left_over)


def remove_library(library: Path) -> bool:
    """Remove a library and the remains of interrupted compilations of it.

    A process that has loaded it keeps it. Return False if it is being compiled, or cannot be
    removed.
    """
    try:
        with lock_library(library, wait=False):
            library.unlink(missing_ok=True)
            _clear_left_over(library)
    except OSError:
        return False
    return True


def list_left_over(folder: Path) -> set[Path]:
    """Return the libraries of which compilations, running or interrupted, have left files."""
    names = (LEFT_OVER.fullmatch(name) for name in os.listdir(folder))
    return {folder / f"{name['library']}.so" for name in names if name}


def _clear_left_over(library: Path) -> None:
    import shutil

    for scratch in library.parent.glob(f"{library.stem}.building-*"):
        shutil.rmtree(scratch, ignore_errors=True)
