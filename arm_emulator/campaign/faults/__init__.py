"""Faults, a file each: found by their files, known by their `kind`."""

from __future__ import annotations

import importlib
import os
from functools import cache

from arm_emulator.campaign.fault import Fault


@cache
def known_faults() -> dict[str, type[Fault]]:
    """Return all kinds by name."""
    names = sorted(one[:-3] for one in os.listdir(__path__[0]) if one.endswith(".py"))
    for name in names:
        if name != "__init__":
            importlib.import_module(f"{__name__}.{name}")
    return {one.kind: one for one in sorted(Fault.__subclasses__(), key=lambda one: one.kind)}
