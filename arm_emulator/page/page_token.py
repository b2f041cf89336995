"""The secret in the page's address, one per user: a restarted page has the same one."""

from __future__ import annotations

import contextlib
import os
import secrets
from pathlib import Path

from arm_emulator.base.refusal import Refusal
from arm_emulator.build.library_cache import writable_caches

NAME = "page_token"
BYTES = 16


def page_token() -> str:
    """Return this user's token, from the cache folder; a new one where it cannot be kept."""
    with contextlib.suppress(Refusal, OSError, ValueError):  # no folder, or not ours
        for folder in writable_caches():
            return _kept(folder / NAME)
    return secrets.token_urlsafe(BYTES)


def _kept(file: Path) -> str:
    """Return the token of a file that no other user can read; write it where the file is missing.

    Raises:
        OSError: the file cannot be written or read.
        ValueError: others can read it, or it has no token.
    """
    fresh = secrets.token_urlsafe(BYTES)
    beside = file.with_name(f".{NAME}_{fresh}")
    with os.fdopen(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as one:
        one.write(fresh)
    try:
        with contextlib.suppress(FileExistsError):  # whole, or not at all
            os.link(beside, file)
    finally:
        beside.unlink()
    with open(os.open(file, os.O_RDONLY | os.O_NOFOLLOW)) as found:
        state = os.fstat(found.fileno())
        token = found.read()
        if state.st_uid != os.getuid() or state.st_mode & 0o077 or len(token) != len(fresh):
            raise ValueError(file)
    return token
