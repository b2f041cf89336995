"""Compiled code of formulas and conditions: core/boundary/formula.c and what is built on it."""

from __future__ import annotations

from arm_emulator.build.c_header import Header
from arm_emulator.build.flags import C_FLAGS
from arm_emulator.build.unit import Unit, compiled_once
from arm_emulator.core import BOUNDARY
from arm_emulator.tick.c import FOLDER, FOLDERS

FORMULA = Header(BOUNDARY / "formula.h")
TOOL_POSITION = Header(BOUNDARY / "tool_position.h")
CONDITION = Header(FOLDER / "condition.h", FOLDERS)
BREAKPOINT = Header(FOLDER / "breakpoint.h", FOLDERS)


def formula_unit() -> Unit:
    """Return the sources of formulas, tool positions, conditions and breakpoints."""
    parts = "formula.c", "tool_position.c", "condition.c", "breakpoint.c"
    source = "".join(f'#include "{part}"\n' for part in parts)
    headers = FORMULA, TOOL_POSITION, CONDITION, BREAKPOINT
    about = "formulas and conditions"
    return Unit("formula", source, C_FLAGS, FOLDERS, headers, "formula", about, parts[0])


formula_library = compiled_once(formula_unit)
