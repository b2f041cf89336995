"""The schemes, found by their files."""

from __future__ import annotations

import importlib
import pkgutil

from arm_emulator.machine import schemes
from arm_emulator.machine.schemes.scheme import Scheme


def _found() -> dict[str, type[Scheme]]:
    for module in pkgutil.iter_modules(schemes.__path__):
        importlib.import_module(f"{schemes.__name__}.{module.name}")
    return {one.name: one for one in sorted(Scheme.__subclasses__(), key=_rank)}


def _rank(scheme: type[Scheme]) -> tuple[bool, int, int, str]:
    """The default first, then the cheapest: by evaluations, and by order among these."""
    return not scheme.default, scheme.evaluations, -scheme.order, scheme.name


KNOWN = _found()  # by name; the first is the default
SCHEMES = tuple(KNOWN)
LOCATING_SCHEMES = tuple(name for name, one in KNOWN.items() if one.locates)
