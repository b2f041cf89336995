"""Replacement of values in YAML texts, with comments and all other text kept."""

from __future__ import annotations

import re
from collections.abc import Iterable


def edited(text: str, edits: Iterable[tuple[int, int, str]]) -> str:
    """Return a text with pieces replaced.

    Args:
        text: YAML.
        edits: first character, end, replacement. They do not overlap.
    """
    for start, end, value in sorted(edits, reverse=True):
        tail = text[end:]
        # A comment after the value keeps its column.
        comment = re.match(r"( {2,})#", tail)
        if comment:
            blanks = len(comment[1]) + (end - start) - len(value)
            tail = " " * max(2, blanks) + tail[len(comment[1]) :]
        text = text[:start] + value + tail
    return text
