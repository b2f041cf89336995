"""The kinds of faults: those of parts, and those in the files of this package."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator

from arm_emulator.machine import faults
from arm_emulator.machine.parts.fault import Fault
from arm_emulator.machine.parts.found import kinds_below
from arm_emulator.machine.parts.part import Part


def _declared() -> Iterator[Fault]:
    for one in pkgutil.iter_modules(faults.__path__):
        module = importlib.import_module(f"{faults.__name__}.{one.name}")
        yield from getattr(module, "FAULTS", ())
    for kind in kinds_below(Part):
        if hasattr(kind, "section"):
            yield from kind.faults()


def _kinds() -> tuple[Fault, ...]:
    """Return all kinds, by their names."""
    found: dict[str, Fault] = {}
    for one in _declared():
        assert found.setdefault(one.name, one) == one, f"two faults are called {one.name}"
    return tuple(sorted(found.values(), key=lambda one: one.name))


FAULTS = _kinds()
