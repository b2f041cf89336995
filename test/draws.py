"""Number of cases of a class per run."""

import os
from collections.abc import Iterable
from typing import Any, TypeVar

import pytest

T = TypeVar("T")

FULL = bool(os.environ.get("FULL"))


def some(cases: Iterable[T], count: int) -> list[T]:
    """The first `count` cases, so that a run stays short; all of them in `make test-in-full`."""
    return list(cases) if FULL else list(cases)[:count]


def with_slow(cases: Iterable[Any], count: int) -> list[Any]:
    """All cases, for `parametrize`; those after the first `count` are slow tests.

    They must judge again what the first ones judge.
    """
    every = [case if isinstance(case, tuple) else (case,) for case in cases]
    slow = [pytest.param(*case, marks=pytest.mark.slow) for case in every[count:]]
    return [pytest.param(*case) for case in every[:count]] + slow
