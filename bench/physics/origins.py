"""Origins of a scene's figures: published, or assumed within a range.

In a scene file the comment beside a figure states it: ``[1]``, a source that the head of the file
names, or ``assumed 0.09 to 0.14``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import yaml

from arm_emulator.base.refusal import Refusal

SECTIONS = ("motor", "gear", "friction")  # of a joint, that must name where they are from
_NUMBER = r"([\d.e+-]+(?:/\d+)?)"
_ASSUMED = re.compile(rf"\bassumed {_NUMBER} to {_NUMBER}")
_SOURCE = re.compile(r"\[(\d+)\]")


@dataclass(frozen=True)
class NumberOrigin:
    """Origin of one figure of a scene, which several joints may share."""

    section: str  # such as motor, or motor.friction
    key: str
    value: float
    joints: tuple[str, ...]
    line: int  # of the file
    assumed: tuple[float, float] | None  # the range; None: published
    source: str = ""  # where, or for what is assumed, empty

    def list_names(self) -> list[str]:
        """Return the names of the figure as `varied` of a scene has them."""
        return [f"joints.{joint}.{self.section}.{self.key}" for joint in self.joints]


def list_origins(file: Path) -> list[NumberOrigin]:
    """Return the origin of each number of motors, gears and friction, in the order of the file.

    Raises:
        Refusal: a figure has no mark, a source is not named in the head of the file, or a value
            is not within its range.
    """
    text = file.read_text(encoding="utf-8")
    lines = text.splitlines()
    named = dict(re.findall(r"^# \[(\d+)\] (.*)", text, re.M))
    origin_by_place: dict[tuple[int, int], tuple[str, str, float, list[str]]] = {}
    joints = _list_entries(yaml.compose(text)).get("joints")
    for joint, node in _list_entries(joints).items():
        for section in SECTIONS:
            for path, number in _list_numbers(_list_entries(node).get(section), section):
                mark, (at, _, key) = number.start_mark, path.rpartition(".")
                place = mark.line, mark.column
                origin_by_place.setdefault(place, (at, key, float(number.value), []))[3].append(
                    joint
                )
    return [
        _find_origin(file, lines[line], line + 1, named, at, key, value, tuple(joints))
        for (line, _), (at, key, value, joints) in sorted(origin_by_place.items())
    ]


def _find_origin(
    file: Path, text: str, line: int, named: dict[str, str], section: str, key: str, value: float,
    joints: tuple[str, ...],
) -> NumberOrigin:  # fmt: skip
    where, comment = f"{file.name}, line {line}", text.partition("#")[2]
    assumed, source = _ASSUMED.search(comment), _SOURCE.search(comment)
    at = f"{section}.{key}"
    if assumed:
        low, high = (float(Fraction(group)) for group in assumed.groups())
        if not low <= value <= high:
            raise Refusal(where, at, f"be within what is assumed, {low:g} to {high:g}", value)
        return NumberOrigin(section, key, value, joints, line, (low, high))
    if source is None or source[1] not in named:
        rule = "have a source, such as [1], that the head of the file names, or be assumed"
        raise Refusal(where, at, rule, comment.strip() or "nothing", "assumed LOW to HIGH")
    return NumberOrigin(section, key, value, joints, line, None, named[source[1]])


def _list_entries(node: yaml.Node | None) -> dict[str, yaml.Node]:
    if not isinstance(node, yaml.MappingNode):
        return {}
    return {key.value: value for key, value in node.value}


def _list_numbers(node: yaml.Node | None, path: str) -> Iterator[tuple[str, yaml.ScalarNode]]:
    for key, value in _list_entries(node).items():
        if isinstance(value, yaml.ScalarNode) and value.tag.endswith((":float", ":int")):
            yield f"{path}.{key}", value
        yield from _list_numbers(value, f"{path}.{key}")
