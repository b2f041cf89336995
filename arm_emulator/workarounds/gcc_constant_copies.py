"""Copies of constant arrays by GCC 12 for processors with AVX-512.

Versions: GCC 12.1 and 12.2. Reason: the copy of a constant array that begins as {v, v, 0, 0} begins
as {v, v, v, v}. GCC takes a constant of 256 bits, whose upper half is not stored, for one that
repeats its lower half. Narrower stores avoid that, at some 3 % of a step's time.
Test: test/toolchain/test_workarounds.py, `test_gcc_copies_constants_wrongly_for_wide_stores`.
"""

import re

FLAG = "-mstore-max=128"
_MACRO = re.compile(r"^#define (\w+) (\S+)$", re.M)


def list_flags(macros: str) -> list[str]:
    """Return the flags that a compiler needs, by what it prints with ``-dM -E``."""
    value_of = dict(_MACRO.findall(macros))
    if "__clang__" in value_of or "__AVX512F__" not in value_of:
        return []
    version = value_of.get("__GNUC__"), value_of.get("__GNUC_MINOR__")
    return [FLAG] if version in (("12", "1"), ("12", "2")) else []
