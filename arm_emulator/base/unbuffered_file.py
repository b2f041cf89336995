"""A new file whose every write reaches the system, or fails."""

from __future__ import annotations

from pathlib import Path

from arm_emulator.base.mcap_end import write_all


class UnbufferedFile:
    """Takes bytes.

    A buffer would keep what the system did not take, and hand it over later, behind a gap.
    """

    def __init__(self, file: Path) -> None:
        self._raw = file.open("xb", buffering=0)
        self._at = 0
        self.fileno, self.close = self._raw.fileno, self._raw.close

    @property
    def closed(self) -> bool:
        """Whether it takes no more."""
        return self._raw.closed

    def write(self, data: bytes) -> int:
        """Write all of it.

        Raises:
            OSError: the system does not take all.
        """
        write_all(self._raw, data)
        self._at += len(data)
        return len(data)

    def tell(self) -> int:
        """Return how many bytes it has taken."""
        return self._at

    def truncate(self, size: int) -> None:
        """Take back what stands behind `size` bytes."""
        self._raw.truncate(size)
        self._raw.seek(size)
        self._at = size

    def flush(self) -> None:
        """Nothing waits here."""
