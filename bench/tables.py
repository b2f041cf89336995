"""Tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable


def format_table(
    heads: Iterable[str], rows: Iterable[Iterable[object]], numbers: bool = False
) -> str:
    """Return a table; with `numbers` all columns but the first are aligned to the right."""
    heads = list(heads)
    lines = [_format_row(heads), f"|---{('|---:' if numbers else '|---') * (len(heads) - 1)}|"]
    return "\n".join([*lines, *map(_format_row, rows)])


def _format_row(cells: Iterable[object]) -> str:
    return "".join(f"| {cell} " if cell != "" else "| " for cell in cells) + "|"
