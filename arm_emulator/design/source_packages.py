"""Packages of ROS in the folders around a file, as in a clone of a maker's repository.

They are found by their `package.xml`, without a sourced shell and whatever their folder is called.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

MANIFEST = "package.xml"
MOST_BYTES = 1 << 20  # of a manifest; a larger file has no name
MOST_FOLDERS = 1000  # that are looked at beside each folder above the file

_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_NAME = re.compile(r"<name>\s*([A-Za-z0-9_.-]+)\s*</name>")


def source_packages(folder: Path) -> dict[str, Path]:
    """Return the packages around a folder, by name: those above it, and next to these.

    Of two with the same name the nearer counts.
    """
    found: dict[str, Path] = {}
    folder = folder.resolve()
    for place in (folder, *folder.parents):
        for candidate in (place, *_subfolders(place)):
            name = _package_name(candidate / MANIFEST)
            if name:
                found.setdefault(name, candidate)
    return found


def _subfolders(folder: Path) -> Iterator[Path]:
    try:
        entries = sorted(folder.iterdir())
    except OSError:  # a folder that may be passed through, but not read
        return
    yield from entries[:MOST_FOLDERS]


def _package_name(manifest: Path) -> str:
    """Return the name that a manifest gives; empty without one."""
    try:
        if not manifest.is_file() or manifest.stat().st_size > MOST_BYTES:
            return ""
        text = manifest.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    name = _NAME.search(_COMMENT.sub("", text))
    return name[1] if name else ""
