"""Numbers of joints as tables of Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from arm_emulator.base.escape import markdown_text

# In a line above, as units as headings would make it too wide for a narrow window.
UNITS = "rad, rad/s, N m (slides: m, m/s, N), A, and what the motor got"


def number_table(names: Sequence[str], columns: dict[str, Any]) -> str:
    """Return columns (N,) by their headings as a table, a line per joint."""
    lines = ["| | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    for j, name in enumerate(names):
        cells = (_cell(np.asarray(one)[j]) for one in columns.values())
        lines.append(f"| {markdown_text(name)} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(value: Any) -> str:
    if isinstance(value, np.integer):
        return str(int(value))
    return "-" if np.isnan(value) else f"{float(value) + 0.0:.5g}"
