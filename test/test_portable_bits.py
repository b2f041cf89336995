"""The bits of machines, fleets and servos are those that other compilers and processors compute."""

import json

import pytest
from draws import with_slow
from portable_bits import STORED, digests


@pytest.mark.parametrize("count", with_slow([1, 3], 1))
def test_bits_are_those_of_every_compiler_and_processor(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # `make test` compiles at another level, by quick_cxx, on the strength of this test.
    monkeypatch.delenv("CXX", raising=False)
    expected = json.loads(STORED.read_text())
    computed = dict(digests("native", "-O3", count))
    assert computed == {name: expected[name] for name in computed}, (
        "the physics, or a compiler, differs"
    )
