"""Numbers of a scene that are data of each machine, not constants of the compiled core."""

from __future__ import annotations

import difflib
import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from arm_emulator.base.number import Number
from arm_emulator.base.refusal import Refusal

Kind = TypeVar("Kind")


@dataclass(frozen=True)
class Varied:
    """One of them; its name is its place in the scene."""

    number: Number
    value: float  # that a machine begins with

    @property
    def name(self) -> str:
        """Its place in the scene."""
        return self.number.name


def choose(
    wanted: Sequence[object], possible: Mapping[str, Kind], where: str, key: str, rule: str
) -> tuple[Kind, ...]:
    """Return what is named, each once and in the order of the scene.

    Args:
        wanted: names such as ``payload.mass``, or patterns such as ``joints.*.friction.coulomb``.
        possible: all that can be chosen, by name.
        where: the file, for refusals.
        key: of the list in the file, for refusals.
        rule: for refusals.

    Raises:
        Refusal: a name or pattern that no choice has.
    """
    chosen = set()
    for one in wanted:
        found = fnmatch.filter(possible, one) if isinstance(one, str) else []
        if not found:
            near = isinstance(one, str) and difflib.get_close_matches(one, possible)
            raise Refusal(where, key, rule, one, ", ".join(near or possible) or "none")
        chosen.update(found)
    return tuple(one for name, one in possible.items() if name in chosen)


def varied_number(varied: Sequence[Varied], name: object, where: str) -> Varied:
    """Return the one of a scene's varied numbers by its name.

    Raises:
        Refusal: the scene does not list it as varied.
    """
    for one in varied:
        if isinstance(name, str) and one.name == name:
            return one
    known = ", ".join(one.name for one in varied)
    valid = known or "none, see `varied` and `faults` in docs/reference/scene.md"
    raise Refusal(where, "name", "be varied in the scene", name, valid)
