"""Packages beside the core: what they register as entry points of Python."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

from arm_emulator.base.refusal import Refusal

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

COMMANDS = "arm_emulator.commands"  # modules, each of which registers the command of its name
UNITS = "arm_emulator.units"  # functions which return units for `arm_emulator compile`
MODES = "arm_emulator.drive_modes"  # functions which return the modes of a bus's drives
SCENE_UNITS = "arm_emulator.scene_units"  # functions which return the unit of a scene
CARDS = "arm_emulator.card_compilers"  # functions which compile a scene for a card
PAGE = "arm_emulator.page"  # `live` and `run`: a page with a running machine, with a finished run

# Commands of the packages in packages/, by which a refusal names the missing package.
COMMANDS_OF = {
    "analysis": ("advise", "bode", "explain"),
    "campaign": ("campaign", "faults"),
    "export": ("foxglove", "moveit-config", "ros2-control"),
    "fieldbus": ("canopen", "ethercat", "modbus"),
    "firmware": ("firmware",),
    "fmu": ("fmu",),
    "identification": ("accuracy", "identify", "validate"),
    "page": ("look",),
}


@functools.cache
def find_entries(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name; none of them is imported."""
    # Its import takes 30 ms, which a node without a page need not spend.
    from importlib.metadata import entry_points

    return {point.name: point for point in sorted(entry_points(group=group))}


def refuse_missing_package(where: str, name: str) -> Refusal:
    """Return the refusal of what needs a package of packages/, named without `arm_emulator_`."""
    remedy = f"`make setup` or pip install '.[{name}]' in a checkout of arm_emulator"
    return Refusal(where, f"package arm_emulator_{name}", "be installed", "none", remedy)


def find_package_of_command(command: str) -> str | None:
    """Return which package of packages/ has a command; None if no package has it."""
    return next((name for name, commands in COMMANDS_OF.items() if command in commands), None)


def find_page_entry(name: str) -> EntryPoint:
    """Return an entry point of the page's package: `live` or `run`, see `find_entry`."""
    return find_entry("page", PAGE, name)


def find_entry(package: str, group: str, name: str) -> EntryPoint:
    """Return an entry point of a package.

    Raises:
        Refusal: the package is not installed.
    """
    point = find_entries(group).get(name)
    if point is None:
        raise refuse_missing_package(package, package)
    return point


def load_all(group: str) -> list[Any]:
    """Import everything that packages register in a group, in the order of the names."""
    return [point.load() for point in find_entries(group).values()]
