"""Number of cases of a class per run."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import TypeVar

T = TypeVar("T")

FULL = bool(os.environ.get("FULL"))


def some(cases: Iterable[T], count: int) -> list[T]:
    """The first `count` cases, so that a run stays short; all of them in `make test-in-full`."""
    return list(cases) if FULL else list(cases)[:count]
