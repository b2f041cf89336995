"""Compiled code of formulas and conditions: core/boundary/formula.c and what is built on it."""

from __future__ import annotations

from functools import cache

from arm_emulator.build.c_header import Header, Library
from arm_emulator.build.flags import C_FLAGS
from arm_emulator.build.unit import Unit, library
from arm_emulator.core import BOUNDARY

FORMULA = Header(BOUNDARY / "formula.h")
TOOL_POSITION = Header(BOUNDARY / "tool_position.h")
CONDITION = Header(BOUNDARY / "condition.h")
BREAKPOINT = Header(BOUNDARY / "breakpoint.h")


@cache
def formula_library() -> Library:
    """Return the compiled formula.h, compiling it if no cached library fits.

    Raises:
        Refusal: there is neither a sound cached library nor a working compiler.
    """
    return library(formula_unit())


def formula_unit() -> Unit:
    """Return the sources of formulas, tool positions, conditions and breakpoints."""
    parts = "formula.c", "tool_position.c", "condition.c", "breakpoint.c"
    source = "".join(f'#include "{part}"\n' for part in parts)
    headers = FORMULA, TOOL_POSITION, CONDITION, BREAKPOINT
    about = "formulas and conditions"
    return Unit("formula", source, C_FLAGS, (BOUNDARY,), headers, "formula", about, parts[0])
