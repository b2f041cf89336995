"""Numbers of joints as tables of Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from arm_emulator.base.escape import markdown_text

# Headings with units, for joints that turn; those of slides are in the line above the table.
SLIDES = "slides: q in m, v in m/s, gear in N; command: as the motor takes it"
DECIMALS = 4


def number_table(names: Sequence[str], columns: dict[str, Any]) -> str:
    """Return columns (N,) by their headings as a table, a line per joint."""
    lines = ["| | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    for j, name in enumerate(names):
        cells = (_cell(np.asarray(one)[j]) for one in columns.values())
        lines.append(f"| {markdown_text(name)} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def machine_table(
    names: Sequence[str], q: Any, v: Any, gear: Any, current: Any, command: Any, counts: Any
) -> str:
    """Return the state and the measurement of all joints (N,) as a table with its units."""
    columns = {
        "q [rad]": q,
        "v [rad/s]": v,
        "gear [N m]": gear,
        "current [A]": current,
        "command": command,
        "counts": counts,
    }
    return f"{SLIDES}\n\n" + number_table(names, columns)


def _cell(value: Any) -> str:
    if isinstance(value, np.integer):
        return str(int(value))
    if np.isnan(value):
        return "-"
    # Equal decimals let the eye compare the lines; what is too large or small for them is rare.
    fits = value == 0.0 or 0.5 * 10.0**-DECIMALS <= abs(value) < 1e5
    return f"{float(value) + 0.0:.{DECIMALS}f}" if fits else f"{float(value):.1e}"
