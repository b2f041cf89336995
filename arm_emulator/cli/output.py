"""Output of a command: lines as text, or one JSON object."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from arm_emulator.base import warning

if TYPE_CHECKING:
    from rich.console import Console


class Output:
    """Prints lines, or collects values and prints them as JSON at the end.

    With JSON, all other output of this process, C code included, goes to stderr.

    Args:
        as_json: one JSON object instead of lines.
    """

    def __init__(self, as_json: bool) -> None:
        self.as_json = as_json
        self._stdout = -1
        warning.given.clear()
        standard = sys.__stdout__
        if as_json and standard is not None and sys.stdout is standard:
            standard.flush()
            self._stdout = os.dup(1)
            os.dup2(2, 1)

    def line(self, text: str) -> None:
        """Print a line, unless as JSON."""
        if not self.as_json:
            print(text, flush=True)

    def console(self, least_width: int | None = None) -> Console:
        """Return the console for tables."""
        from rich.console import Console

        width = None if least_width is None else max(least_width, Console().width)
        return Console(
            width=width, highlight=False, soft_wrap=least_width is None, quiet=self.as_json
        )

    def facts(self, facts: Mapping[str, object]) -> None:
        """Print the values as JSON, once."""
        if not self.as_json:
            return
        if self._stdout >= 0:
            sys.stdout.flush()
            os.dup2(self._stdout, 1)
            os.close(self._stdout)
            self._stdout = -1
        print(json.dumps(plain(facts), indent=2), flush=True)


def plain(value: Any) -> Any:
    """Return a value as JSON: without NumPy, and null for numbers that are not finite."""
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if dataclasses.is_dataclass(value):
        return {one.name: plain(getattr(value, one.name)) for one in dataclasses.fields(value)}
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | bool | int):
        return value
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, Sequence | set | frozenset):
        return [plain(one) for one in value]
    return str(value)
