"""Warnings: one line each on stderr, and a list for programs that read JSON."""

from __future__ import annotations

import sys

given: list[str] = []  # by this process


def warn(text: str) -> None:
    """Print a warning."""
    given.append(text)
    print(f"warning: {text}", file=sys.stderr)
