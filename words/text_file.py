"""Files from outside: regular ones of bounded size, and nothing that only looks like a file."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from words.refusal import Refusal


def why_no_file(file: Path) -> str | None:
    """Return in words why a path leads to no regular file; None: it does."""
    try:
        mode = file.stat().st_mode
    except FileNotFoundError:
        return "no such file"
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        return getattr(error, "strerror", None) or str(error)
    if stat.S_ISREG(mode):
        return None
    return "a folder" if stat.S_ISDIR(mode) else "a device, pipe or socket"


def read_bytes(file: Path, most: int) -> bytes:
    """Return what is in a regular file of at most `most` bytes. Never waits for a pipe.

    Raises:
        Refusal: something else than a regular file, a larger one, or one that cannot be read.
    """
    reason: object = why_no_file(file)
    if reason is None:
        try:
            # Not blocking, should it have become a pipe since.
            descriptor = os.open(file, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOCTTY)
            with open(descriptor, "rb") as stream:
                content = stream.read(most + 1) or b""
        except OSError as error:
            reason = error.strerror or error
    if reason is not None:
        raise Refusal(file.name, "file", "be readable", reason)
    if len(content) > most:
        raise Refusal(file.name, "file", f"have at most {most // 1024} KiB", "more")
    return content
