"""The kinds of faults, which stand in the files of this package."""

from __future__ import annotations

import importlib
import pkgutil

from arm_emulator.machine import faults
from arm_emulator.machine.faults.fault import Fault


def _kinds() -> tuple[Fault, ...]:
    """Return all kinds, by their names."""
    names = (one.name for one in pkgutil.iter_modules(faults.__path__))
    modules = (importlib.import_module(f"{faults.__name__}.{name}") for name in names)
    return tuple(
        sorted(
            (one for module in modules for one in getattr(module, "FAULTS", ())),
            key=lambda one: one.name,
        )
    )


FAULTS = _kinds()
