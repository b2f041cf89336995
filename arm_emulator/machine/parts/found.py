"""The kinds of a part, which are the classes in the files of this package."""

from __future__ import annotations

import importlib
import pkgutil
from typing import TypeVar

from arm_emulator.machine import parts
from arm_emulator.machine.parts.part import Part

Kind = TypeVar("Kind", bound=Part)


def kinds_of(base: type[Kind]) -> list[type[Kind]]:
    """Return the classes that inherit a class directly, by their sections."""
    for module in pkgutil.iter_modules(parts.__path__):
        importlib.import_module(f"{parts.__name__}.{module.name}")
    return sorted(base.__subclasses__(), key=lambda one: one.section)
