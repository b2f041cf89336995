"""Files that others find whole or not at all, whenever their writer is killed."""

import errno
import os
from pathlib import Path
from typing import IO


def write_atomically(file: Path, content: str | bytes) -> None:
    """Write a temporary file in the same folder, and move it to its place."""
    hidden = name_hidden_file(file)
    hidden.write_bytes(content.encode() if isinstance(content, str) else content)
    hidden.replace(file)


def name_hidden_file(file: Path) -> Path:
    """Return a file in the same folder that no other process writes."""
    return file.with_name(f".{file.name}.{os.uname().nodename}.{os.getpid()}")


class UnbufferedFile:
    """File opened without a buffer.

    A buffer would keep bytes that the system refused, and write them later, after a gap.
    """

    def __init__(self, file: Path) -> None:
        self._raw = file.open("xb", buffering=0)
        self._at = 0
        self.fileno, self.close = self._raw.fileno, self._raw.close

    @property
    def closed(self) -> bool:
        """Whether it accepts no more bytes."""
        return self._raw.closed

    def write(self, data: bytes) -> int:
        """Write all bytes.

        Raises:
            OSError: not all bytes were written.
        """
        write_all(self._raw, data)
        self._at += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self._at

    def truncate(self, size: int) -> None:
        """Remove the bytes after `size`."""
        self._raw.truncate(size)
        self._raw.seek(size)
        self._at = size

    def flush(self) -> None:
        """Do nothing: there is no buffer."""


def write_all(stream: IO[bytes], data: bytes) -> None:
    """Write to a file without a buffer, which may accept a part at a time.

    Raises:
        OSError: not all bytes were written.
    """
    rest = memoryview(data)
    while rest:
        taken = stream.write(rest)
        if not taken:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        rest = rest[taken:]


def flush_to_disk(descriptor: int) -> None:
    """Wait for the disk: some report only now that they are full, or over a quota.

    Raises:
        OSError: not all bytes were written.
    """
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP):  # fsync is not supported
            raise
