"""What a command prints: lines for people, or one JSON object for programs."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any


class Output:
    """Prints lines, or collects facts and prints them as JSON at the end.

    Args:
        as_json: one JSON object in the place of lines.
    """

    def __init__(self, as_json: bool) -> None:
        self.as_json = as_json

    def line(self, text: str) -> None:
        """Print a line for people."""
        if not self.as_json:
            print(text, flush=True)

    def facts(self, facts: Mapping[str, object]) -> None:
        """Print the same for programs."""
        if self.as_json:
            print(json.dumps(plain(facts), indent=2), flush=True)


def plain(value: Any) -> Any:
    """Return a value as JSON has it: no NumPy, and null for what is no finite number."""
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | bool | int):
        return value
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, Sequence | set | frozenset):
        return [plain(one) for one in value]
    return str(value)
