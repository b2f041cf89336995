"""Facts of the build of a machine's code, in words: compiler, flags, and digest of the source."""

import re
from pathlib import Path

from arm_emulator.machine.plant.compiler import build_machine_unit
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.toolchain.unit import compute_sources_digest

COMPILED_BY, COMPILED_WITH, COMPILED_FROM = "compiled by", "compiled with", "compiled from"
# Compilers leave their name in each library; clang's have GCC's start-up code in them, too.
_COMPILERS = rb"[\w ]*clang version [\d.]+", rb"GCC: \([^)\0]*\) [\d.]+"


def build_facts(plant: Plant) -> dict[str, str]:
    """Return the facts of a machine's compiled code, by their names."""
    unit = build_machine_unit(plant.scene)
    library = Path(plant.core.file).read_bytes()
    named = [
        match[0].decode().strip()
        for pattern in _COMPILERS
        if (match := re.search(pattern, library))
    ]
    return {
        COMPILED_BY: named[0] if named else "unknown",
        COMPILED_WITH: " ".join(unit.flags),
        COMPILED_FROM: compute_sources_digest(unit),
    }


def list_differing_builds(
    names: tuple[str, str], left: dict[str, str], right: dict[str, str]
) -> list[str]:
    """Return how two builds differ, a sentence each; facts that one lacks are left out.

    Args:
        names: of both sides.
        left: facts of the first, see `build_facts`.
        right: of the second.
    """
    sentences = []
    for fact in (COMPILED_BY, COMPILED_WITH, COMPILED_FROM):
        a, b = left.get(fact), right.get(fact)
        if a is None or b is None or a == b:
            continue
        if fact == COMPILED_WITH:
            a, b = _list_missing(a, b), _list_missing(b, a)
        sentences.append(f"{fact} {a} ({names[0]}), {b} ({names[1]})")
    return sentences


def _list_missing(left_flags: str, right_flags: str) -> str:
    """Return the flags that only the first has; in another order, all."""
    left = list(left_flags.split())
    for flag in right_flags.split():
        if flag in left:
            left.remove(flag)
    if not left and sorted(left_flags.split()) == sorted(right_flags.split()):
        return left_flags
    return " ".join(left) or "no further flag"
