"""Values in YAML texts replaced where they stand, comments and all else kept."""

from __future__ import annotations

import re
from collections.abc import Iterable


def edited(text: str, edits: Iterable[tuple[int, int, str]]) -> str:
    """Return a text with pieces replaced.

    Args:
        text: YAML.
        edits: from which character on, to which, and what shall stand there. They do not overlap.
    """
    for start, end, value in sorted(edits, reverse=True):
        tail = text[end:]
        # A comment behind the value stays in its column.
        comment = re.match(r"( {2,})#", tail)
        if comment:
            blanks = len(comment[1]) + (end - start) - len(value)
            tail = " " * max(2, blanks) + tail[len(comment[1]) :]
        text = text[:start] + value + tail
    return text
