"""Values put in place of those of a scene file, by dotted path."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from arm_emulator.base.refusal import Refusal


def override_keys(data: dict[str, Any], dotted: str, value: object, where: str) -> None:
    """Put a value into what a scene file holds, see `load_scene`."""
    places: list[tuple[dict[str, Any], list[str]]] = [(data, dotted.split("."))]
    while places:
        place, steps = places.pop()
        for key, rest in _find_keys(place, steps):
            if not rest:
                if value is None:
                    place.pop(key, None)
                else:
                    place[key] = value
                continue
            # A copy, since YAML anchors make several joints share one mapping.
            child = place.get(key)
            if child is None:
                child = {}
            if not isinstance(child, dict):
                raise Refusal(where, f"override {dotted}", "lead through sections", child)
            place[key] = dict(child)
            below = [".".join(rest)] if key == "locked" and place is data else rest
            places.append((place[key], below))


def convert_to_plain(value: object) -> object:
    """Return a value as a file would give it: numbers of Python, sequences as lists."""
    if isinstance(value, np.floating):
        return float(str(value))  # the digits that it stands for, whatever its width
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: convert_to_plain(element) for key, element in value.items()}
    return (
        [convert_to_plain(element) for element in value]
        if isinstance(value, list | tuple)
        else value
    )


def _find_keys(place: dict[str, Any], steps: list[str]) -> list[tuple[str, list[str]]]:
    """Return the keys that the first steps of a dotted path mean, with the steps that remain.

    Names of joints may have dots: the longest key that is there is meant.
    """
    if steps[0] == "*":
        return [(key, steps[1:]) for key in list(place)]
    for count in range(len(steps), 1, -1):
        key = ".".join(steps[:count])
        if key in place:
            return [(key, steps[count:])]
    return [(steps[0], steps[1:])]
