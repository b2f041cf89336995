"""Values of dropdowns, which a browser may have set to any text."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any


def chosen(control: Any, known: Collection[str]) -> str:
    """Return the value of a dropdown; the first known one replaces any other value."""
    value = str(control.value)
    if value not in known:
        control.value = value = next(iter(known))
    return value
