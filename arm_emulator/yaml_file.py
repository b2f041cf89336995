"""YAML as people write it: 1e-4 is a number, and no key is given twice."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from arm_emulator.refusal import Refusal


class _Loader(yaml.CSafeLoader):
    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key_node, _ in node.value:
            if key_node.value in seen and key_node.value != "<<":
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key_node.value!r} is given twice", key_node.start_mark
                )
            seen.add(key_node.value)
        return super().construct_mapping(node, deep)


# YAML 1.1 wants a dot and a sign in 1.0e-4; YAML 1.2, ROS and people do not.
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$"),
    list("-+0123456789."),
)


def read_yaml(file: Path) -> dict[str, Any]:
    """Return the mapping that a YAML file holds.

    Raises:
        Refusal: no such file, not YAML, or something else than a mapping.
    """
    try:
        data = yaml.load(file.read_text(encoding="utf-8"), Loader=_Loader)
    except OSError as error:
        raise Refusal(file.name, "file", "be readable", error.strerror or error) from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise Refusal(file.name, "file", "be well-formed YAML", error) from None
    if not isinstance(data, dict):
        raise Refusal(file.name, "file", "be a mapping of keys to values", type(data).__name__)
    return data
