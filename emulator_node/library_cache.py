"""Where the compiled cores of scenes are kept."""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from arm_emulator.refusal import Refusal

CACHE_VARIABLE = "ARM_EMULATOR_CACHE"


def cache_folders() -> list[Path]:
    """Return where libraries may lie, the preferred place first."""
    named = os.environ.get(CACHE_VARIABLE)
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "arm_emulator"
    shared = Path(tempfile.gettempdir()) / f"arm_emulator-{os.getuid()}"
    return [Path(named)] if named else [user, shared]


def writable_cache() -> Path:
    """Return the folder for new libraries.

    Raises:
        Refusal: there is none.
    """
    for folder in cache_folders():
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError:
            continue
        # A library from a folder that somebody else can write to is somebody else's code.
        if folder.stat().st_uid == os.getuid():
            return folder
    raise Refusal(
        "arm_emulator",
        "cache folder",
        "be writable",
        " or ".join(map(str, cache_folders())),
        f"set {CACHE_VARIABLE} to a folder of yours",
    )


@contextlib.contextmanager
def locked(file: Path) -> Iterator[None]:
    """Hold the lock `file`; other processes wait for it."""
    with file.open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
