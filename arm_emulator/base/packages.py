"""Packages beside the core: what they register as entry points of Python."""

from __future__ import annotations

import functools
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from arm_emulator.base.refusal import Refusal

COMMANDS = "arm_emulator.commands"  # modules, each of which registers the command of its name
UNITS = "arm_emulator.units"  # functions which return units for `arm_emulator compile`
MODES = "arm_emulator.drive_modes"  # functions which return the modes of a bus's drives
PAGE = "arm_emulator.page"  # `live` and `run`: a page with a running machine, with a finished run


@functools.cache
def registered(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name; none of them is imported."""
    return {point.name: point for point in sorted(entry_points(group=group))}


def registered_as(group: str, name: str, package: str) -> EntryPoint:
    """Return one entry point.

    Args:
        group: one of those above.
        name: in the group.
        package: which package has it.

    Raises:
        Refusal: no package that is installed has it.
    """
    point = registered(group).get(name)
    if point is None:
        remedy = f"pip install {package}"
        raise Refusal(name, f"package {package}", "be installed", "none", remedy)
    return point


def load_all(group: str) -> list[Any]:
    """Import everything that packages register in a group, in the order of the names."""
    return [point.load() for point in registered(group).values()]
