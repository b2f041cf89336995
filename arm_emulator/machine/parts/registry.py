"""The registry of parts: each is registered in its file, and owns its section of the scene."""

from typing import TypeVar

from arm_emulator.base.registry import Registry
from arm_emulator.machine.parts.part import Part

Kind = TypeVar("Kind", bound=Part)

_PARTS = Registry[Part]("part", __package__ or "", lambda kind: str(kind.name_place()))
register_part = _PARTS.register


def list_kinds(base: type[Kind]) -> list[type[Kind]]:
    """Return the registered parts that inherit a class or are it, by their sections."""
    kinds = [kind for kind in _PARTS.list_kinds().values() if issubclass(kind, base)]
    return sorted(kinds, key=lambda kind: kind.section)
