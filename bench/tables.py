"""Tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable


def table(heads: Iterable[str], rows: Iterable[Iterable[object]], numbers: bool = False) -> str:
    """Return a table; with `numbers` all columns but the first are aligned to the right."""
    heads = list(heads)
    lines = [_row(heads), f"|---{('|---:' if numbers else '|---') * (len(heads) - 1)}|"]
    return "\n".join([*lines, *map(_row, rows)])


def _row(cells: Iterable[object]) -> str:
    return "".join(f"| {cell} " if cell != "" else "| " for cell in cells) + "|"
