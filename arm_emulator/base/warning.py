"""Warnings: one line each on stderr, and a list for programs that read JSON."""

import sys

issued: list[str] = []  # by this process


def print_warnings(*texts: str) -> None:
    """Print warnings."""
    issued.extend(texts)
    for text in texts:
        print(f"warning: {text}", file=sys.stderr)
