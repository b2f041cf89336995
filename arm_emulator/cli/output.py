"""Output of a command: lines for people, or one JSON object for programs."""

from __future__ import annotations

import contextlib
import math
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from arm_emulator.base import warning

if TYPE_CHECKING:
    from rich.console import Console


WIDEST = 500  # columns of a table: one that is wider than the terminal is not cut


class CommandOutput:
    """Prints lines; or collects values, and prints them as JSON at the end.

    With JSON, all other output of this process, C code included, goes to stderr.

    Attributes:
        as_json: one JSON object instead of lines.
        collected: that object so far.
    """

    def __init__(self) -> None:
        self.as_json = False
        self.collected: dict[str, object] = {}
        self._stdout = -1

    @contextlib.contextmanager
    def print_at_end(self, *, as_json: bool) -> Iterator[None]:
        """Within, a command runs; its object is printed however it ends."""
        self.as_json, self.collected = as_json, {}
        warning.issued.clear()
        standard = sys.__stdout__
        if as_json and standard is not None and sys.stdout is standard:
            standard.flush()
            self._stdout = os.dup(1)
            os.dup2(2, 1)
        try:
            yield
        finally:
            self.print_object()

    def print_line(self, text: str) -> None:
        """Print a line, unless as JSON."""
        if not self.as_json:
            print(text, flush=True)

    def make_console(self, min_width: int | None = None) -> Console:
        """Return the console for tables and other text without markup."""
        from rich.console import Console

        width = None if min_width is None else max(min_width, Console().width)
        return Console(
            width=width, highlight=False, soft_wrap=min_width is None, quiet=self.as_json
        )

    def print_table(
        self, heads: Sequence[str], rows: Iterable[Sequence[str]], *, title: str = "", left: int = 1
    ) -> None:
        """Print rows of cells below their heads; the first columns stand left, numbers right."""
        from rich.table import Table
        from rich.text import Text

        table = Table(box=None, pad_edge=False, title=title or None, title_justify="left")
        for k, head in enumerate(heads):
            table.add_column(Text(head), justify="left" if k < left else "right", no_wrap=True)
        for row in rows:
            table.add_row(*map(Text, row))
        self.make_console(WIDEST).print(table)

    def add_facts(self, facts: Mapping[str, object]) -> None:
        """Add values to the object."""
        self.collected.update(facts)

    def report_miss(self, command: str, missed: str) -> int:
        """Report why a command has missed its goal, or nothing if empty; return the exit code."""
        self.add_facts({"missed": missed or None})
        if missed:
            print(f"arm_emulator: {command}: goal not reached: {missed}", file=sys.stderr)
        return 1 if missed else 0

    def print_object(self) -> None:
        """Print the object, once."""
        if not self.as_json:
            return
        import json  # not before: `--version` takes longer by what it imports

        self.as_json = False
        if self._stdout >= 0:
            sys.stdout.flush()
            os.dup2(self._stdout, 1)
            os.close(self._stdout)
            self._stdout = -1
        facts = {**self.collected, "warnings": warning.issued}
        print(json.dumps(convert_to_plain(facts), indent=2), flush=True)


output = CommandOutput()  # of this process


def convert_to_plain(value: Any) -> Any:
    """Return a value as JSON: without NumPy, and null for numbers that are not finite."""
    import dataclasses

    if isinstance(value, Mapping):
        return {str(key): convert_to_plain(element) for key, element in value.items()}
    if dataclasses.is_dataclass(value):
        return {
            field.name: convert_to_plain(getattr(value, field.name))
            for field in dataclasses.fields(value)
        }
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | bool | int):
        return value
    if hasattr(value, "tolist"):
        return convert_to_plain(value.tolist())
    if isinstance(value, Sequence | set | frozenset):
        return [convert_to_plain(element) for element in value]
    return str(value)
