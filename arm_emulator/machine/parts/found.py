"""The kinds of a part, which are the classes in the files of this package."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from typing import TypeVar

from arm_emulator.machine import parts
from arm_emulator.machine.parts.part import Part

Kind = TypeVar("Kind", bound=Part)


def kinds_of(base: type[Kind]) -> list[type[Kind]]:
    """Return the classes that inherit a class directly, by their sections."""
    _import_all()
    return sorted(base.__subclasses__(), key=_section)


def kinds_below(base: type[Kind]) -> list[type[Kind]]:
    """Return the classes that inherit a class, directly or not."""
    return [one for kind in kinds_of(base) for one in (kind, *kinds_below(kind))]


def last_kinds(base: type[Kind]) -> list[type[Kind]]:
    """Return those that no class inherits, by their sections."""
    last = (one for one in kinds_below(base) if not one.__subclasses__())
    return sorted(last, key=_section)


@cache
def _import_all() -> None:
    for module in pkgutil.iter_modules(parts.__path__):
        importlib.import_module(f"{parts.__name__}.{module.name}")


def _section(kind: type[Part]) -> str:
    return getattr(kind, "section", "")
