"""Files that others find whole or not at all, whenever their writer is killed."""

from __future__ import annotations

import os
from pathlib import Path


def write_whole(file: Path, content: str | bytes) -> None:
    """Write a file beside its place, and move it there."""
    hidden = hidden_beside(file)
    hidden.write_bytes(content.encode() if isinstance(content, str) else content)
    hidden.replace(file)


def hidden_beside(file: Path) -> Path:
    """Return a file in the same folder that no other process writes."""
    return file.with_name(f".{file.name}.{os.uname().nodename}.{os.getpid()}")
