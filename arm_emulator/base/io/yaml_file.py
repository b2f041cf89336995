"""YAML with three rules: 1e-4 is a number, every key is a text, and no key occurs twice.

A document is checked as a stream of events before it is built. The result therefore has a bounded
size and depth for any file.
"""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml

from arm_emulator.base.io.text_file import read_bytes
from arm_emulator.base.refusal import Refusal

MAX_BYTES = 1 << 20
MAX_VALUES = 20_000  # keys and values, those that aliases repeat among them
MAX_LEVELS = 32
_FLOAT = (
    r"^[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$"
    r"|^[-+]?\.(inf|Inf|INF)$|^\.(nan|NaN|NAN)$"
)
_LARGEST_INT = 2**63 - 1


class _Loader(yaml.CSafeLoader):
    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = set()
        for key_node, _ in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                raise _refuse_document(key_node, "a key is a text, not a list or section")
            if key_node.value in keys and key_node.value != "<<":
                raise _refuse_document(key_node, f"key {key_node.value!r} is given twice")
            keys.add(key_node.value)
        self.flatten_mapping(node)
        return {key.value: self.construct_object(value, deep=deep) for key, value in node.value}

    def construct_integer(self, node: yaml.ScalarNode) -> int | float:
        text = str(node.value)
        number = float(text)
        return int(text) if abs(number) < _LARGEST_INT else number


def _refuse_document(node: yaml.Node, problem: str) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)


# Meaning of a plain scalar, as in YAML 1.2 and ROS: 010 is ten, 1:30 and 2001-01-01 are
# texts, 1e-4 is a number.
_Loader.yaml_implicit_resolvers = {}
for _kind, _pattern, _first in (
    ("bool", r"^(true|True|TRUE|false|False|FALSE)$", "tTfF"),
    ("int", r"^[-+]?[0-9]+$", "-+0123456789"),
    ("float", _FLOAT, "-+0123456789."),
    ("null", r"^(~|null|Null|NULL|)$", ["~", "n", "N", ""]),
    ("merge", r"^<<$", "<"),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_kind}", re.compile(_pattern), list(_first))
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_integer)


def read_yaml(file: Path) -> dict[str, Any]:
    """Return the mapping in a YAML file.

    Raises:
        Refusal: the file is missing, not YAML, too large, too deep, or not a mapping.
    """
    data = parse_yaml(read_bytes(file, MAX_BYTES), file.name)
    if not isinstance(data, dict):
        actual = "nothing" if data is None else type(data).__name__
        raise Refusal(file.name, "file", "be a mapping of keys to values", actual)
    return data


def parse_yaml(text: bytes | str, where: str) -> Any:
    """Return the content of one YAML document: dict, list, text, number, bool or None.

    Args:
        text: the document, of at most `MAX_BYTES`.
        where: its name in refusals.

    Raises:
        Refusal: not YAML, too large or too deep.
    """
    try:
        if isinstance(text, bytes):
            text = text.decode("utf-8-sig")
        if len(text) > MAX_BYTES:
            raise Refusal(where, "file", f"have at most {MAX_BYTES // 1024} KiB", "more")
        _check_nodes(text, where)
        return yaml.load(text, Loader=_Loader)
    except UnicodeError as error:
        actual = getattr(error, "reason", error)
        raise Refusal(where, "file", "be written in UTF-8", actual) from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        at = f"line {mark.line + 1}: " if mark is not None else ""
        raise Refusal(where, "file", "be well-formed YAML", f"{at}{error.problem}") from None
    except yaml.YAMLError as error:
        raise Refusal(where, "file", "be well-formed YAML", error) from None


def _check_nodes(text: str, where: str) -> None:
    """Refuse a document that exceeds the bounds, before it is built."""
    documents = levels = values = 0
    starts: list[tuple[str | None, int]] = []  # of open collections: anchor, values before it
    sizes: dict[str, int] = {}  # of what an anchor names, in values
    for event in yaml.parse(text, Loader=yaml.CSafeLoader):
        anchor = getattr(event, "anchor", None)
        tag = getattr(event, "tag", None)
        if tag is not None:
            raise Refusal(where, "file", "be plain YAML without tags", f"the tag {tag}")
        if isinstance(event, yaml.DocumentStartEvent):
            documents += 1
            if documents > 1:
                raise Refusal(where, "file", "hold one document", "several")
        elif isinstance(event, yaml.CollectionStartEvent):
            levels += 1
            values += 1
            starts.append((anchor, values))
            if levels > MAX_LEVELS:
                raise Refusal(where, "file", f"nest at most {MAX_LEVELS} levels", "more")
        elif isinstance(event, yaml.CollectionEndEvent):
            levels -= 1
            anchor, before = starts.pop()
            if anchor is not None:
                sizes[anchor] = values - before + 1
        elif isinstance(event, yaml.AliasEvent):
            if any(anchor == opened for opened, _ in starts):
                raise Refusal(
                    where, "file", "have no recursive anchors", f"*{anchor} within &{anchor}"
                )
            values += sizes.get(anchor or "", 1)
        elif isinstance(event, yaml.ScalarEvent):
            values += 1
            if anchor is not None:
                sizes[anchor] = 1
        if values > MAX_VALUES:
            raise Refusal(where, "file", f"hold at most {MAX_VALUES} keys and values", "more")


def read_nodes(text: str) -> dict[str, tuple[yaml.Node, yaml.Node]]:
    """Return key and value of everything in a document's sections, by dotted paths.

    What an alias repeats stands under each of its paths.
    """
    nodes: dict[str, tuple[yaml.Node, yaml.Node]] = {}

    def collect_nodes(node: yaml.Node | None, path: str) -> None:
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                nodes[f"{path}{key.value}"] = key, value
                collect_nodes(value, f"{path}{key.value}.")

    collect_nodes(yaml.compose(text, yaml.SafeLoader), "")
    return nodes


def edit_yaml(text: str, edits: Iterable[tuple[int, int, str]]) -> str:
    """Return a text with pieces replaced.

    Args:
        text: YAML.
        edits: first character, end, replacement. They do not overlap.
    """
    for start, end, value in sorted(edits, reverse=True):
        tail = text[end:]
        # A comment after the value keeps its column.
        comment = re.match(r"( {2,})#", tail)
        if comment:
            blanks = len(comment[1]) + (end - start) - len(value)
            tail = " " * max(2, blanks) + tail[len(comment[1]) :]
        text = text[:start] + value + tail
    return text
