"""The bits of machines, fleets and servos are those that other compilers and processors compute."""

from __future__ import annotations

import json

from portable_bits import KEPT, digests


def test_bits_are_those_of_every_compiler_and_processor() -> None:
    kept = json.loads(KEPT.read_text())
    found = dict(digests("native", "-O3"))
    assert found == {name: kept[name] for name in found}, "the physics, or a compiler, differs"
