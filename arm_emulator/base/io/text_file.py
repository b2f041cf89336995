"""Files from outside: regular files of bounded size only.

Every file that a user names is opened here. The module of its kind reads it: `yaml_file`,
`urdf_text`, `table_file`, `array_file`.
"""

import os
import stat
from pathlib import Path
from typing import IO

from arm_emulator.base.refusal import Refusal

PIECE = 1 << 24  # bytes read at a time, so that memory follows the file, not the limit


def explain_missing_file(file: Path) -> str | None:
    """Return why a path is not a regular file; None if it is."""
    try:
        return _explain_irregular_file(file.stat().st_mode)
    except FileNotFoundError:
        return "no such file"
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        return getattr(error, "strerror", None) or str(error)


def open_file(file: Path) -> IO[bytes]:
    """Open a regular file for reading. Never waits for a pipe.

    Raises:
        Refusal: not a regular file, or one that cannot be opened.
    """
    reason: object = explain_missing_file(file)
    if reason is None:
        try:
            # Not blocking, in case it has become a pipe since.
            flags = os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOCTTY
            stream = open(os.open(file, flags), "rb")
            reason = _explain_irregular_file(os.fstat(stream.fileno()).st_mode)
            if reason is None:
                return stream
            stream.close()
        except OSError as error:
            reason = error.strerror or error
    raise Refusal(file.name or str(file), "file", "be readable", reason)


def read_bytes(file: Path, max_bytes: int) -> bytes:
    """Return the content of a regular file of at most `max_bytes` bytes.

    Raises:
        Refusal: not a regular file, too large, or not readable.
    """
    pieces, size = list[bytes](), 0
    with open_file(file) as stream:
        try:
            while size <= max_bytes and (piece := stream.read(min(PIECE, max_bytes + 1 - size))):
                pieces.append(piece)
                size += len(piece)
        except OSError as error:
            raise Refusal(file.name, "file", "be readable", error.strerror or error) from None
    if size > max_bytes:
        raise Refusal(file.name, "file", f"have at most {max_bytes // 1024} KiB", "more")
    return b"".join(pieces)


def read_text(file: Path, max_bytes: int) -> str:
    """Return the text of a regular file of at most `max_bytes` bytes in UTF-8, line ends unchanged.

    Raises:
        Refusal: see `read_bytes`, or another encoding.
    """
    try:
        return read_bytes(file, max_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise Refusal(file.name, "file", "be text in UTF-8", error.reason) from None


def _explain_irregular_file(mode: int) -> str | None:
    if stat.S_ISREG(mode):
        return None
    return "a folder" if stat.S_ISDIR(mode) else "a device, pipe or socket"
