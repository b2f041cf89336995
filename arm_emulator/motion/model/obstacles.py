"""Obstacles of an arm: a floor, boxes. The section `obstacles` of the parameter file."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.number import Number
from arm_emulator.base.validation.parameters import split_tables

OBSTACLES = "obstacles"  # the section's name
_LENGTH = Number("", "m", above=0.0, at_most=1e3)
_PLACE = Number.bound_size("", "m", 1e3)
_ANGLE = Number.bound_size("", "rad", 10.0)
_KEYS = "height", "size", "at", "rpy"


@dataclass(frozen=True)
class Obstacle:
    """A box in the world, or the space below a height."""

    name: str
    height: float | None = None
    """Height of a floor [m]; None for a box."""
    size: tuple[float, ...] = (1.0, 1.0, 1.0)
    """Size of a box along its axes [m]."""
    at: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Middle of the box [m]."""
    rpy: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Orientation: roll, pitch, yaw as in a URDF [rad]."""


def read_obstacles(section: object, where: str) -> tuple[Obstacle, ...]:
    """Return the obstacles of a section; nested, or with ROS's dotted names."""
    tables = split_tables(section, where, OBSTACLES)
    return tuple(_read_obstacle(name, table, where) for name, table in tables.items())


def _read_obstacle(name: str, table: Mapping[str, Any], where: str) -> Obstacle:
    path = f"{OBSTACLES}.{name}"
    for key in table:
        if key not in _KEYS:
            raise Refusal(where, f"{path}.{key}", "be a known key", "another", ", ".join(_KEYS))
    if "height" in table:
        if len(table) > 1:
            raise Refusal(where, path, "be a floor (height) or a box", sorted(table))
        height = _PLACE.rename(f"{path}.height").check_value(where, table["height"])
        return Obstacle(name, height)
    if "size" not in table:
        raise Refusal(where, path, "have a height (a floor) or a size (a box)", sorted(table))
    values = {
        key: _read_three(table[key], number, where, f"{path}.{key}")
        for key, number in (("size", _LENGTH), ("at", _PLACE), ("rpy", _ANGLE))
        if key in table
    }
    return Obstacle(name, None, **values)


def _read_three(values: object, number: Number, where: str, path: str) -> tuple[float, ...]:
    return tuple(number.rename(path).check_row(where, values, 3).tolist())
