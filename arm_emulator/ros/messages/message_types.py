"""Message types by name: their classes, and their definitions in the form of bags."""

import importlib
import re
from functools import cache
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from arm_emulator.base.refusal import Refusal


@cache
def get_message_class(kind: str) -> Any:
    """Return the class of a message type such as ``std_msgs/msg/String``.

    Raises:
        Refusal: it is not installed here.
    """
    package, _, name = kind.partition("/msg/")
    try:
        types = getattr(importlib.import_module(f"{package}.msg"), name)
        types.get_fields_and_field_types()
        return types
    except (ImportError, AttributeError, TypeError, ValueError):
        raise Refusal("bag", f"message type {kind}", "be installed", "none of that name") from None


def read_definition(kind: str) -> str:
    """Return the text of a message's definition, followed by those of all types in it.

    Empty if only IDL is installed. Format: https://mcap.dev/spec/registry#ros2msg
    """
    waiting, texts = [kind.replace("/msg/", "/")], {}
    while waiting:
        contained = waiting.pop(0)
        if contained in texts:
            continue
        package, name = contained.split("/")
        try:
            file = Path(get_package_share_directory(package)) / "msg" / f"{name}.msg"
            texts[contained] = file.read_text(encoding="utf-8")
        except (PackageNotFoundError, OSError):
            return ""
        waiting += _list_contained_types(texts[contained], package)
    root, *rest = texts.items()
    separator = "=" * 80
    return root[1] + "".join(f"\n{separator}\nMSG: {kind}\n{text}" for kind, text in rest)


def list_fields(definition: str) -> list[str]:
    """Return the fields and constants of the first message in a definition, without comments."""
    first = definition.partition("=" * 80)[0]
    lines = (" ".join(line.partition("#")[0].split()) for line in first.splitlines())
    return [line for line in lines if line]


def _list_contained_types(text: str, package: str) -> list[str]:
    """Return the message types of a definition's fields."""
    types = []
    for line in list_fields(text):
        base = re.split(r"[\[<]", line.split()[0])[0]
        if "/" in base:
            types.append(base.replace("/msg/", "/"))
        elif base[0].isupper():  # a message of the same package; the built-in types are lower case
            types.append(f"{package}/{base}")
    return types
