"""A new file whose every write reaches the system, or fails."""

from __future__ import annotations

from pathlib import Path

from arm_emulator.base.mcap_end import write_all


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
