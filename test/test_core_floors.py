"""Includes between headers of the core: a floor depends only on those below it."""

from __future__ import annotations

import re
from pathlib import Path

from arm_emulator.core import CORE

FLOORS = ("numerics", "parts", "mechanics", "schemes", "machine", "boundary")


def floor_of(file: Path) -> str:
    return file.relative_to(CORE).parts[0]


def test_a_header_includes_headers_of_its_floor_or_below() -> None:
    files = [file for file in CORE.rglob("*") if file.suffix in (".hpp", ".cpp", ".h", ".c")]
    assert {floor_of(file) for file in files} == set(FLOORS), "the floors"
    wrong, observed = [], 0
    for file in files:
        floor = FLOORS.index(floor_of(file))
        for name in re.findall(r'^#include "(.+)"', file.read_text(), re.M):
            target = CORE / name if "/" in name else file.parent / name
            assert target.is_file(), f"{file.name}: {name}"
            to = FLOORS.index(floor_of(target))
            observed += 1
            if to > floor:
                wrong.append(f"{file.relative_to(CORE)} includes {name}")
    assert observed > 100 and not wrong, wrong


def included(file: Path, observed: set[Path]) -> set[Path]:
    for name in re.findall(r'^#include "(.+)"', file.read_text(), re.M):
        if (CORE / name).is_file() and CORE / name not in observed:
            observed.add(CORE / name)
            included(CORE / name, observed)
    return observed


def test_a_header_includes_the_number_that_it_uses() -> None:
    """In a scene any part may come first."""
    real = CORE / "numerics" / "real.hpp"
    files = [file for file in CORE.rglob("*.hpp") if file.name not in ("real.hpp", "dual.hpp")]
    users = [file for file in files if re.search(r"\bReal\b", re.sub("//.*", "", file.read_text()))]
    assert len(users) > 50
    assert not [user_file.name for user_file in users if real not in included(user_file, set())]
