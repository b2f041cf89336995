"""Facts of the build of a machine's code, in words: compiler, flags, and digest of the source."""

from __future__ import annotations

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
    named = [found[0].decode().strip() for one in _COMPILERS if (found := re.search(one, library))]
    return {
        COMPILED_BY: named[0] if named else "unknown",
        COMPILED_WITH: " ".join(unit.flags),
        COMPILED_FROM: compute_sources_digest(unit),
    }


def list_differing_builds(
    names: tuple[str, str], one: dict[str, str], other: dict[str, str]
) -> list[str]:
    """Return how two builds differ, a sentence each; facts that one lacks are left out.

    Args:
        names: of both sides.
        one: facts of the first, see `build_facts`.
        other: of the second.
    """
    sentences = []
    for fact in (COMPILED_BY, COMPILED_WITH, COMPILED_FROM):
        a, b = one.get(fact), other.get(fact)
        if a is None or b is None or a == b:
            continue
        if fact == COMPILED_WITH:
            a, b = _list_missing(a, b), _list_missing(b, a)
        sentences.append(f"{fact} {a} ({names[0]}), {b} ({names[1]})")
    return sentences


def _list_missing(one: str, other: str) -> str:
    """Return the flags that only the first has; in another order, all."""
    left = list(one.split())
    for flag in other.split():
        if flag in left:
            left.remove(flag)
    if not left and sorted(one.split()) == sorted(other.split()):
        return one
    return " ".join(left) or "no further flag"
